"""Cameras, lenses and geometry in one solve: the optimum that two steps with shared errors reach, and better than
without.
"""

import numpy as np
import pytest

from calib.correction import simultaneous_camera_and_geometry_fit
from calib.correction.simultaneous_camera_and_geometry_fit import refine_correction_with_cameras
from calib.models.platform.platform_identification import identify_platform
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import RigError
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.recording import recording_folder
from tests.conftest import make_recording


@pytest.fixture(scope="module")
def solved(tmp_path_factory, design, rig_text):
    folder = tmp_path_factory.mktemp("joint") / "rec"
    secret, _ = make_recording(folder, design, rig_text, 5, count=40)
    read = recording_folder.load_recording(folder)
    sampled = sample_recording(read)
    corners, commanded, state = simultaneous_camera_and_geometry_fit.inputs_of_camera_and_geometry_fit(
        sampled.measurement, sampled.samples
    )
    return (
        secret,
        read,
        sampled,
        simultaneous_camera_and_geometry_fit.fit_cameras_and_geometry(
            corners, commanded, state, read.design.cameras, read.design.mechanism
        ),
        corners,
    )


def test_two_steps_with_shared_errors_reach_the_joint_optimum(solved):
    _, read, sampled, found, _ = solved
    two = identify_platform(sampled.samples, read.design.mechanism)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.abs((geometric_parameters(two.mechanism) - geometric_parameters(found.mechanism)) / sigma).max() < 0.05
    np.testing.assert_allclose(np.sqrt(np.diag(two.covariance)), sigma, rtol=0.02)


def test_the_truth_lies_where_the_covariance_says(solved):
    secret, _, _, found, corners = solved
    error = geometric_parameters(found.mechanism) - geometric_parameters(secret.true.mechanism)
    assert (
        18 < error @ np.linalg.solve(found.covariance, error) < 80
    )  # chi-square of 42: one in 2000 lies beyond either
    assert np.mean(found.residuals**2) == pytest.approx(1, abs=0.05) and len(found.residuals) == len(corners)
    for camera, true in zip(found.cameras, secret.true.cameras):
        assert camera.matrix[0, 0] == pytest.approx(true.matrix[0, 0], abs=0.6)


def test_moving_cameras_and_missing_base_targets_are_refused(solved):
    _, read, sampled, _, corners = solved
    _, commanded, state = simultaneous_camera_and_geometry_fit.inputs_of_camera_and_geometry_fit(
        sampled.measurement, sampled.samples
    )
    on = corners.take(corners.on_platform)
    with pytest.raises(RigError, match="targets on the base"):
        simultaneous_camera_and_geometry_fit.fit_cameras_and_geometry(
            on, commanded, state, read.design.cameras, read.design.mechanism
        )


def test_a_calibration_is_refined_or_the_reason_said(solved, design):
    from dataclasses import replace

    from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction

    _, read, sampled, found, _ = solved
    correction, two = fit_geometry_and_remainder_of_correction(sampled.samples, read.design.mechanism)
    better, reason = refine_correction_with_cameras(sampled, read.design, correction, two)
    np.testing.assert_allclose(geometric_parameters(better.fitted), geometric_parameters(found.mechanism), atol=1e-9)
    np.testing.assert_allclose(reason.covariance, found.covariance, rtol=1e-6, atol=1e-16)
    with pytest.raises(RigError, match="came from poses.csv"):
        refine_correction_with_cameras(
            replace(sampled, measurement=None, source="poses.csv"), read.design, correction, two
        )
    with pytest.raises(RigError, match="strut 2 scatters by 30.0 um"):
        refine_correction_with_cameras(
            sampled, read.design, correction, replace(two, scatter=np.array([0, 3e-5, 0, 0, 0, 0]))
        )
