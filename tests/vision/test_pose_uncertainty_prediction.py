"""Poses that cameras have yet to see: as sure, and with the same errors in common, as where they have been seen."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.errors import RigError
from rig.model.pose import exp
from rig.recording import recording_folder
from tests.closed_loops import rig
from vision.pose_uncertainty_prediction import predict_pose_uncertainty
from vision.recording_combination_and_moved_cameras import _apart
from vision.recording_measurement import measure_recording


@pytest.fixture(scope="module", params=["cubes", "hand"])
def measured(request, tmp_path_factory):
    """(Measurement, Design) of an arm with cubes in its hand, or a camera."""
    at = tmp_path_factory.mktemp(request.param)
    rig(
        "design",
        "--arm",
        "ur10",
        "--seen",
        request.param,
        "--cameras",
        2 if request.param == "cubes" else 1,
        "--out",
        at / "rig.toml",
    )
    rig("simulate", at / "rig.toml", "--plan", "sobol:24", "--seed", "4", "--out", at / "rec")
    read = recording_folder.load_recording(at / "rec")
    return measure_recording(read)[0], read.design


def test_poses_seen_already_are_foretold_as_they_were_measured(measured):
    found, design = measured
    predicted = predict_pose_uncertainty(found, design, found.T_base_platform)
    assert predicted.seen.all() and predicted.common.shape == found.common.shape
    total = [predicted.covariance + predicted.common @ np.swapaxes(predicted.common, 1, 2), found.covariance]
    for part in (slice(0, 3), slice(3, 6)):
        sizes = [np.sqrt(np.trace(one[:, part, part], axis1=1, axis2=2)) for one in total]
        assert 0.8 < np.median(sizes[0] / sizes[1]) < 1.25
    sigma = np.sqrt(np.einsum("nii->ni", found.covariance))[..., None]
    moved, shared = predicted.common / sigma, found.common / sigma
    alike = (
        (moved * shared).sum() / np.linalg.norm(moved) / np.linalg.norm(shared)
    )  # the same draws, the same way round
    assert alike > 0.85


def test_what_no_camera_would_see_is_left_out(measured):
    found, design = measured
    away = RigidTransform.from_translation([0.0, 0.0, 50.0]) * found.T_base_platform[:1]
    both = RigidTransform.concatenate([found.T_base_platform[:2], away])
    predicted = predict_pose_uncertainty(found, design, both)
    assert predicted.seen.tolist() == [True, True, False] and len(predicted.covariance) == len(predicted.common) == 2
    none = predict_pose_uncertainty(found, design, away)
    assert not none.seen.any() and none.covariance.shape == (0, 6, 6)


def test_markers_whose_places_were_adjusted_are_refused():
    unsure = SimpleNamespace(adjustment=SimpleNamespace(unknowns=SimpleNamespace(local_poses={})), places_free=True)
    with pytest.raises(RigError, match="markers at their stated positions"):
        predict_pose_uncertainty(unsure, None, RigidTransform.identity())


def test_a_camera_alone_in_a_hand_stands_where_it_stood():
    """Its stated place holds the hand's frame: its covariance is nought, and as likely as not to be singular."""
    held = (RigidTransform.identity(), np.zeros((6, 6)))
    assert _apart(held, held)[1] == 1.0
    sure = (RigidTransform.identity(), 1e-8 * np.diag([1.0, 1, 1, 0, 0, 0]))
    displaced = (exp(np.array([1e-3, 0, 0, 0, 0, 0])), sure[1])
    assert _apart(sure, displaced)[1] < 1e-6 and _apart(sure, sure)[1] == pytest.approx(1.0)
