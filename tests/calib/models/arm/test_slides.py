"""Arms with slides: their independent parameters, how well these are found, and what a correction makes of few
joints.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.models.arm import (
    arm_base_and_tool_placement_in_instrument_frame,
    arm_error_model_and_instrument_observations,
)
from calib.models.arm.arm_certification import arm_correction_and_identification
from calib.models.arm.arm_error_model_and_instrument_observations import pose_observations
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm, independent_arm_parameter_mask
from rig.errors import Unreachable
from rig.model.pose import exp, log
from tests.calib import secret_arms as worlds
from tests.rig.arms import GANTRY, SCARA, SEVEN, STANFORD, UR10, configurations

ARMS = {"6R": UR10, "scara": SCARA, "gantry": GANTRY}


def scores(nominal, seeds, count=80):
    """(seeds, parameters) errors of arms found from a tracker's poses, in the standard deviations stated."""
    free, out = independent_arm_parameter_mask(nominal, "pose"), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        true = worlds.secret(nominal, rng)
        found = identify_arm(
            pose_observations(worlds.tracked(true, nominal, count, rng)),
            replace(nominal, base=worlds.BASE, tool=worlds.TOOL),
        )
        assert found.rank.free.sum() == free.sum()
        out.append(worlds.scores(found, true, nominal, free))
    return np.array(out)


@pytest.mark.parametrize("arm", [SCARA, GANTRY, STANFORD, UR10, SEVEN], ids=["scara", "gantry", "stanford", "6R", "7R"])
@pytest.mark.parametrize("kind, extra", [("pose", 6), ("position", 3), ("distance", 0)])
def test_counts_of_independent_parameters(arm, kind, extra):
    """4 R + 2 P + 6 of whole poses; the rank of the model says of joints that turn what the rules say."""
    slides = arm.slides.sum()
    assert (
        arm_error_model_and_instrument_observations.generally_independent_parameters(arm, kind).sum()
        == independent_arm_parameter_mask(arm, kind).sum()
        == 4 * (len(arm.slides) - slides) + 2 * slides + extra
    )


@pytest.mark.parametrize("name", ["scara", "gantry"])
def test_parameters_lie_within_three_sigma(name):
    z = scores(ARMS[name], range(8))
    assert (np.abs(z) < 3).mean() > 0.98 and np.abs(z).max() < 4.5 and np.mean(z**2) == pytest.approx(1, abs=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_scores_of_parameters_over_200_runs(name):
    z = scores(ARMS[name], range(200))
    assert abs(z.mean()) < 0.1 and 0.95 < z.std() < 1.05


@pytest.mark.parametrize("name", ["scara", "gantry"])
def test_an_unknown_place_is_found(name):
    """As far as the hand's positions tell it: a hand that never turns, or about one axis alone, leaves the target's
    place to the base's.
    """
    nominal, rng = ARMS[name], np.random.default_rng(3)
    true = worlds.secret(nominal, rng)
    seen = pose_observations(worlds.tracked(true, nominal, 40, rng))
    found = identify_arm(
        seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, nominal, True, True)
    )
    assert found.inliers.all() and not found.scatter.any()
    q = configurations(nominal, 50, rng, 0.5)
    assert (
        np.abs(
            log(
                arm_error_model_and_instrument_observations.predicted_target_poses(q, true).inv()
                * arm_error_model_and_instrument_observations.predicted_target_poses(q, found.arm)
            )
        ).max()
        < 3e-4
    )


@pytest.mark.slow
def test_few_joints_are_commanded_to_the_nearest_pose_and_the_rest_is_told():
    rng = np.random.default_rng(4)
    true = worlds.secret(SCARA, rng)
    samples = worlds.tracked(true, SCARA, 80, rng)
    correction, found = arm_correction_and_identification(samples, SCARA, worlds.TRACKER, False)
    tilt = np.zeros((20, 6))
    tilt[:, 3:5] = 1e-3 * rng.normal(size=(20, 2))
    tool = found.arm.tool.rotation.as_matrix()
    wanted = arm_error_model_and_instrument_observations.predicted_target_poses(
        configurations(SCARA, 20, rng, 0.4), true
    )
    wanted = wanted * exp(
        np.concatenate([tilt[:, :3], tilt[:, 3:] @ tool], axis=1)
    )  # about axes across the hand's own, which nothing turns about
    commands = correction.inverse(wanted)
    rest = correction.rest(wanted, commands)
    assert np.abs(rest[:, :3]).max() < 1e-10
    np.testing.assert_allclose(np.linalg.norm(rest[:, 3:], axis=1), np.linalg.norm(tilt, axis=1), atol=1.5e-4)
    reached = arm_error_model_and_instrument_observations.predicted_target_poses(commands, true)
    assert (
        np.linalg.norm((reached.translation - wanted.translation), axis=1).max() < 5e-5
    )  # 20 um of the tracker, 80 poses
    plain = correction.uncorrected(wanted)
    assert (
        np.linalg.norm(
            arm_error_model_and_instrument_observations.predicted_target_poses(plain, true).translation
            - wanted.translation,
            axis=1,
        ).max()
        > 1e-4
    )
    np.testing.assert_allclose(correction.summand(commands), 0, atol=0.05)
    upside_down = wanted * exp(np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0]))
    with pytest.raises(Unreachable, match="has 4 joints"):
        correction.inverse(upside_down)
