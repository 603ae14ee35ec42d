"""Which joint solution an arm's command takes: the same in whatever frame poses are given, and the same elbow for the
nominal model as corrected.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import arm_correction_and_identification
from calib.models.arm.arm_correction import ArmCorrection
from rig.errors import Unreachable
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.closed_form_and_numerical_arm_inverse import closed_form_inverse, closed_form_of_six_joint_arm
from rig.model.pose import pose, pose_difference
from tests.calib import secret_arms as worlds
from tests.rig.arms import SEVEN, UR10

ELSEWHERE = pose([0.3, 2.0, -1.0], [0.3, -1.1, 0.8])


def drawn(arm, seed, count=30, deviation=None):
    """(Samples of a secret arm, poses (80,) that its joints can take, away from a stretched elbow and wrist)."""
    rng = np.random.default_rng(seed)
    true = worlds.secret(arm, rng)
    samples = worlds.tracked(true, arm, count, rng, deviation=deviation)
    q = worlds.configurations_of(arm, 200, rng)
    bent = (np.abs(np.sin(q[:, 2])) > 0.2) & (np.abs(np.sin(q[:, 4])) > 0.2)
    return samples, arm_error_model_and_instrument_observations.predicted_target_poses(q[bent][:80], true)


@pytest.mark.parametrize(
    ("arm", "seed"),
    [
        pytest.param(UR10, 5, marks=pytest.mark.slow),
        pytest.param(UR10, 8, marks=pytest.mark.slow),
        (SEVEN, 3),
        (SEVEN, 5),
    ],
)
def test_the_tracker_elsewhere_changes_no_command(arm, seed):
    samples, wanted = drawn(arm, seed)
    here, _ = arm_correction_and_identification(samples, arm, worlds.TRACKER, False)
    displaced, _ = arm_correction_and_identification(
        replace(samples, T_base_platform=ELSEWHERE * samples.T_base_platform), arm, worlds.TRACKER, False
    )
    commands = here.inverse(wanted)
    np.testing.assert_allclose(displaced.inverse(ELSEWHERE * wanted), commands, atol=1e-8)
    assert np.abs(pose_difference(here.predict(commands), wanted)).max() < 1e-10


@pytest.mark.slow
def test_the_single_step_is_on_the_elbow_of_the_fixed_point_and_no_whole_turn_is_counted():
    samples, wanted = drawn(UR10, 0, 60, lambda q: 2e-3 * np.sin(q))
    correction, _ = arm_correction_and_identification(samples, UR10, worlds.TRACKER, False)
    try:
        step = correction.single_step(wanted)
    except Unreachable as error:  # beyond the owner's reach by micrometres
        wanted = wanted[np.setdiff1d(np.arange(len(wanted)), error.index)]
        step = correction.single_step(wanted)
    off = correction.missed(wanted, step)
    assert 1e-6 < np.nanmax(np.abs(off)) < 0.1
    np.testing.assert_allclose(correction.inverse(wanted), step - off, atol=1e-6)
    turned = step + 2 * np.pi * (step < 0)
    np.testing.assert_allclose(correction.missed(wanted, turned), off, atol=1e-6)


def test_joint_values_are_apart_by_less_than_half_a_turn_and_slides_by_all_of_it():
    arm = replace(UR10, slides=np.arange(6) == 2)
    apart = mechanism.joint_value_difference(
        np.array([3.1, 0.0, 7.0, 0.0, 0.0, 0.0]), np.array([-3.1, 0.0, 0.0, 0.0, 0.0, 6.0]), arm
    )
    np.testing.assert_allclose(apart, [6.2 - 2 * np.pi, 0, 7.0, 0, 0, 2 * np.pi - 6.0])


@pytest.mark.parametrize("turns", [0, 2 * np.pi])
def test_a_pose_is_taken_in_the_posture_nearest_to_where_the_joints_stand(turns):
    rng = np.random.default_rng(2)
    joints = np.array(UR10.joints) + 2e-4 * rng.normal(size=UR10.joints.shape)
    correction = ArmCorrection(UR10, replace(UR10, joints=joints), (None,) * 6, np.zeros((1, 6)))
    wanted = mechanism.forward(np.array([0.5, -1.2, 1.4, -0.7, 1.1, 0.3]), correction.fitted)
    found = closed_form_inverse(wanted, closed_form_of_six_joint_arm(UR10))
    postures = found.q[found.exists]
    assert len(postures) == 8
    for posture in postures[::2]:
        stand = posture + rng.uniform(-0.1, 0.1, 6) - turns * (posture > 0) * (np.arange(6) == 4)
        chosen = correction.in_posture_nearest_to(wanted, stand, np.ones(6))
        commands = chosen.inverse(wanted)
        assert np.abs(commands - stand).max() < 0.15
        assert np.abs(pose_difference(chosen.predict(commands), wanted)).max() < 1e-10
    slow = np.where(np.arange(6) == 0, 1e-3, 1.0)  # the shoulder is to stay on its side, whatever the others do
    stand = postures[0] + [0.3, 2.0, 2.0, 2.0, 2.0, 2.0]
    chosen = correction.in_posture_nearest_to(wanted, stand, slow).inverse(wanted)
    nearest = np.abs(mechanism.joint_value_difference(postures, stand, UR10)[:, 0]).min()
    assert abs(chosen[0] - stand[0]) < nearest + 0.01


def test_a_pose_beyond_reach_is_refused_from_wherever_the_joints_stand():
    correction = ArmCorrection(UR10, UR10, (None,) * 6, np.zeros((1, 6)))
    far = pose([3.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(Unreachable, match="out of the arm's reach"):
        correction.in_posture_nearest_to(far, np.full(6, 0.1), np.ones(6)).inverse(far)
