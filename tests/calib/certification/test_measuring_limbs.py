"""Measuring limbs: poses from their lengths, agreement with vision that is told truly, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from calib.certification import measuring_limb_calibration_slips_and_vision_agreement
from calib.online.hexapod_information_filter import Online
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import FileError, NotEnoughData, RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import exp, pose_difference
from rig.planning import configuration_generators
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording.recording_folder import Sensors
from tests.calib.noisy_samples import rms


@pytest.fixture(scope="module")
def measured(limbed):
    """(Samples whose commands are the readings, the limbs as stated, all frames, all readings)."""
    design, read, _ = limbed
    frames, lengths = measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(read)
    return (
        measuring_limb_calibration_slips_and_vision_agreement.samples_with_limb_readings_as_commands(
            sample_recording(read).samples, frames, lengths
        ),
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design),
        frames,
        lengths,
    )


def test_readings_are_the_limbs_lengths(limbed, measured):
    _, _, done = limbed
    _, _, frames, lengths = measured
    true = done.world.true.insitu
    legs = done.run.T_base_platform.as_matrix()[:, None, :3, :3] @ true.platform_joints[..., None]
    legs = legs[..., 0] + done.run.T_base_platform.translation[:, None] - true.base_joints
    left = lengths - (np.linalg.norm(legs, axis=2) - true.zeros)
    assert len(frames) == 80 and left.std() == pytest.approx(1e-6, rel=0.15)


def test_calibrated_limbs_measure_poses_as_stated(limbed, measured):
    _, _, done = limbed
    samples, nominal, frames, lengths = measured
    limbs, _ = measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
        samples, nominal, 1e-6
    )
    T = limbs.pose(lengths)
    true = done.run.T_base_platform
    error = pose_difference(true, T)
    own, common = limbs.uncertainty(T)
    assert (
        rms(
            pose_difference(
                true,
                measuring_limb_calibration_slips_and_vision_agreement.Limbs(nominal, np.eye(42), np.ones(6)).pose(
                    lengths
                ),
            )
        )[0]
        > 20 * rms(error)[0]
    )
    total = own + common @ np.swapaxes(common, 1, 2)
    claimed = np.sqrt(np.trace(total[:, :3, :3], axis1=1, axis2=2).mean())
    assert 0.3 < rms(error)[0] / claimed < 2.2  # the limbs' geometry is one draw
    left = error - error.mean(axis=0)
    assert rms(left)[0] < 2e-5


def test_agreement_is_what_covariances_expect(measured):
    samples, nominal, *_ = measured
    T, expected = measuring_limb_calibration_slips_and_vision_agreement.held_out_limb_poses_and_expected_covariance(
        samples, nominal, 1e-6
    )
    found = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        samples.T_base_platform, T, expected, (5e-5, 3e-4)
    )
    assert found.passed.all() and found.n == 80
    assert (found.scatter / found.expected > 0.7).all() and (found.scatter / found.expected < 1.5).all()
    assert (np.abs(found.bias) < 5 * found.scatter / np.sqrt(80) + 0.5 * found.scatter).all()


def test_limits_of_agreement_are_hand_worked(design):
    T = exp(np.zeros((4, 6))) * design.mechanism.home
    shift = np.zeros((4, 6))
    shift[:, 0] = [1e-5, 3e-5, 1e-5, 3e-5]
    found = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        T, T * exp(shift), np.zeros((4, 6, 6)), (1e-3, 1e-3)
    )
    sd = np.sqrt(4 / 3) * 1e-5
    assert found.bias[0] == pytest.approx(2e-5) and found.scatter[0] == pytest.approx(sd)
    np.testing.assert_allclose(found.limits[:, 0], [2e-5 - 1.96 * sd, 2e-5 + 1.96 * sd])
    assert found.proven_limits[0] > found.limits[1, 0] and not found.passed.any()  # nothing moved, so nothing is shown


@pytest.mark.parametrize("spoil", ["bias", "scatter", "scale"])
def test_limbs_that_are_wrong_do_not_pass(measured, spoil):
    samples, nominal, *_ = measured
    T, expected = measuring_limb_calibration_slips_and_vision_agreement.held_out_limb_poses_and_expected_covariance(
        samples, nominal, 1e-6
    )
    wrong = np.zeros((len(samples), 6))
    if spoil == "bias":
        wrong[:, 2] = 6e-5
    elif spoil == "scatter":
        wrong[:, 2] = 4e-5 * np.random.default_rng(0).normal(size=len(samples))
    else:
        wrong[:, 2] = 2e-3 * (samples.T_base_platform.translation[:, 2] - 0.45)
    found = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        samples.T_base_platform, T * exp(wrong), expected, (5e-5, 3e-4)
    )
    assert not found.passed[2] and found.passed[3:].all()


@pytest.mark.slow
def test_struts_are_learnt_from_the_limbs_alone(limbed, measured):
    _, read, done = limbed
    samples, nominal, frames, lengths = measured
    limbs, _ = measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
        samples, nominal, 1e-6
    )
    T = limbs.pose(lengths)
    own, common = limbs.uncertainty(T)
    learner = Online(read.design.mechanism, shared=42)
    commands = read.commanded()[2]
    updates = [learner.update(*each) for each in zip(commands, T, own, common)]
    assert not any(update.changes or update.dropped for update in updates)
    true = done.world.true.mechanism
    lengths = configuration_generators.sobol_configurations(true.strut_range, 100, 0.8)
    error = rms(pose_difference(hexapod.forward(lengths, true), hexapod.forward(lengths, learner.mechanism)))
    before = rms(pose_difference(hexapod.forward(lengths, true), hexapod.forward(lengths, read.design.mechanism)))
    assert error[0] < before[0] / 20
    vision = samples.total_covariance()
    agrees = [
        measuring_limb_calibration_slips_and_vision_agreement.vision_agrees_with_limbs(
            samples.T_base_platform[i], vision[i], T[i], own[i], common[i]
        )
        for i in range(len(samples))
    ]
    assert all(agrees)
    assert not measuring_limb_calibration_slips_and_vision_agreement.vision_agrees_with_limbs(
        samples.T_base_platform[0] * exp(np.array([0, 0, 2e-4, 0, 0, 0])), vision[0], T[0], own[0], common[0]
    )


def test_what_is_missing_is_said(limbed, design, tmp_path):
    _, read, _ = limbed
    with pytest.raises(RigError, match=r"no \[insitu\] table"):
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design)
    with pytest.raises(RigError, match="'m3' is missing"):
        measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(
            replace(
                read, sensors=Sensors(read.sensors.t, {k: v for k, v in read.sensors.channels.items() if k != "m3"})
            )
        )
    with pytest.raises(RigError, match="there is no sensors.csv"):
        measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(replace(read, sensors=None))
    sparse = Sensors(
        np.arange(0.0, 2000.0, 30.0) + 0.123,
        {
            name: np.full(67, 0.5)
            for name in measuring_limb_calibration_slips_and_vision_agreement.stated_limbs(read.design).channels
        },
    )
    with pytest.raises(NotEnoughData, match="within 0.5 s"):
        measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(replace(read, sensors=sparse))
    (tmp_path / "rig.toml").write_text(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6)).replace(
            "length_sigma = 1e-6", "length_sigma = -1"
        )
    )
    with pytest.raises(FileError, match="insitu.length_sigma must be > 0"):
        design_from_rig_toml.load_design(tmp_path / "rig.toml")


def test_too_few_poses_for_limits(measured):
    samples, nominal, *_ = measured
    with pytest.raises(NotEnoughData, match="at least 20"):
        measuring_limb_calibration_slips_and_vision_agreement.held_out_limb_poses_and_expected_covariance(
            samples.take(np.arange(12)), nominal, 1e-6
        )
