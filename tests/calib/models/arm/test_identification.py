"""Hayati's model of an arm from what instruments see: derivatives, convergence, stated against real uncertainty,
rank.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.api.plan import PlanOptions, plan
from calib.models.arm import (
    arm_base_and_tool_placement_in_instrument_frame,
    arm_error_model_and_instrument_observations,
)
from calib.models.arm.arm_error_model_and_instrument_observations import Observations, pose_observations
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm, independent_arm_parameter_mask
from rig.errors import NotEnoughData
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.base_and_link_tilt_sensors import TiltReadings, TiltSensor
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import exp, log, pose, pose_difference
from tests.calib import secret_arms as worlds
from tests.conftest import ROOT
from tests.numerical_derivatives import jacobian
from tests.rig.arms import SEVEN, UR10, configurations, random_arm


@pytest.mark.parametrize("joints, slides, count", [(7, (), 47), (5, (0, 3), 37)])
def test_parameter_jacobian_agrees_with_differences(joints, slides, count):
    arm = random_arm(np.random.default_rng(0), joints, slides)
    q = configurations(arm, 3, np.random.default_rng(1))
    T = arm_error_model_and_instrument_observations.predicted_target_poses(q, arm)
    J = jacobian(
        lambda step: log(
            T.inv()
            * arm_error_model_and_instrument_observations.predicted_target_poses(
                q, arm_error_model_and_instrument_observations.arm_with_parameter_step(arm, step)
            )
        ),
        np.zeros(count),
    )
    np.testing.assert_allclose(arm_error_model_and_instrument_observations.parameter_jacobian(q, arm), J, atol=1e-8)
    np.testing.assert_allclose(
        arm_error_model_and_instrument_observations.joint_jacobian(q, arm),
        arm_error_model_and_instrument_observations.parameter_jacobian(q, arm)[
            ..., arm_error_model_and_instrument_observations.joint_zero_indices(arm)
        ],
        atol=1e-14,
    )
    assert (
        len(arm_error_model_and_instrument_observations.parameter_names(arm))
        == len(arm_error_model_and_instrument_observations.parameter_units(arm))
        == count
    )


def test_parameters_are_named_joint_by_joint():
    arm = random_arm(np.random.default_rng(0), 7)
    assert np.array_equal(arm_error_model_and_instrument_observations.joint_zero_indices(arm), np.arange(6, 41, 5))
    assert arm_error_model_and_instrument_observations.parameter_names(arm)[6:12] == (
        "theta 1",
        "d 1",
        "a 1",
        "alpha 1",
        "beta 1",
        "theta 2",
    )


@pytest.mark.parametrize("make", [worlds.touched, worlds.wired])
def test_rows_of_other_instruments_agree_with_differences(make):
    rng = np.random.default_rng(2)
    arm = worlds.secret(UR10, rng)
    seen = make(arm, UR10, 4, rng)
    predicted = -jacobian(
        lambda step: seen.residuals(arm_error_model_and_instrument_observations.arm_with_parameter_step(arm, step)),
        np.zeros(42),
    )
    np.testing.assert_allclose(seen.jacobian(arm), predicted, atol=1e-8)


@pytest.mark.parametrize("nominal", [UR10, SEVEN], ids=["UR10", "seven"])
@pytest.mark.parametrize("kind, extra", [("pose", 6), ("position", 3), ("distance", 0)])
def test_counts_of_independent_parameters(nominal, kind, extra):
    assert independent_arm_parameter_mask(nominal, kind).sum() == 4 * len(nominal.joints) + extra


@pytest.mark.parametrize("base", [True, False])
@pytest.mark.parametrize("tool", [True, False])
def test_an_unknown_place_is_found(base, tool):
    rng = np.random.default_rng(3)
    true = replace(UR10, base=worlds.BASE, tool=worlds.TOOL)
    seen = pose_observations(worlds.tracked(true, UR10, 30, rng))
    start = replace(UR10, base=UR10.base if base else true.base, tool=UR10.tool if tool else true.tool)
    found = arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, start, base, tool)
    for ours, theirs in ((found.base, true.base), (found.tool, true.tool)):
        assert np.abs(pose_difference(ours, theirs)).max() < 2e-4


@pytest.mark.parametrize("nominal", [UR10, pytest.param(SEVEN, marks=pytest.mark.slow)], ids=["UR10", "seven"])
def test_identification_of_near_parallel_axes_is_as_good_as_it_says(nominal):
    """Every prediction, and every parameter where the truth is one of the model's own figures, lies within the stated
    scatter.
    """
    scores = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        true = worlds.secret(nominal, rng)
        seen = pose_observations(worlds.tracked(true, nominal, 80, rng))
        found = identify_arm(
            seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, nominal, True, True)
        )
        assert not found.scatter.any() and found.inliers.all() and found.rank.free.sum() == 4 * len(nominal.joints) + 6
        q = configurations(nominal, 40, rng, 0.5)
        J = arm_error_model_and_instrument_observations.parameter_jacobian(q, found.arm)
        sigma = np.sqrt(np.einsum("mki,ij,mkj->mk", J, found.covariance, J))
        scores.append(
            pose_difference(
                arm_error_model_and_instrument_observations.predicted_target_poses(q, found.arm),
                arm_error_model_and_instrument_observations.predicted_target_poses(q, true),
            )
            / sigma
        )
    assert np.abs(scores).max() < 5
    assert np.mean(np.square(scores)) == pytest.approx(1, abs=0.35)


@pytest.mark.slow
def test_parameters_lie_within_three_sigma():
    free = independent_arm_parameter_mask(UR10, "pose")
    z = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        true = worlds.secret(UR10, rng)
        seen = pose_observations(worlds.tracked(true, UR10, 80, rng))
        found = identify_arm(
            seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, UR10, True, True)
        )
        z.append(worlds.scores(found, true, UR10, free))
    z = np.array(z)
    assert (np.abs(z) < 3).mean() > 0.985 and np.abs(z).max() < 4.5
    assert np.mean(z**2) == pytest.approx(1, abs=0.3)


def test_positions_and_distances_suffice_too():
    rng = np.random.default_rng(6)
    true = worlds.secret(UR10, rng)
    q = configurations(UR10, 60, rng, 0.5)
    want = arm_error_model_and_instrument_observations.predicted_target_poses(q, true).translation
    seen = worlds.touched(true, UR10, 120, rng)
    found = identify_arm(
        seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, UR10, True, True)
    )
    assert (
        np.linalg.norm(
            arm_error_model_and_instrument_observations.predicted_target_poses(q, found.arm).translation - want, axis=1
        ).max()
        < 1e-4
    )
    wire = worlds.wired(true, UR10, 400, rng)
    start = arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(
        wire, replace(UR10, tool=worlds.TOOL), True, False
    )
    found = identify_arm(wire, start)
    assert (
        np.abs(
            np.linalg.norm(
                arm_error_model_and_instrument_observations.predicted_target_poses(q, found.arm).translation, axis=1
            )
            - np.linalg.norm(want, axis=1)
        ).max()
        < 2e-4
    )
    assert not found.scatter.any()


def test_errors_common_to_all_poses_are_not_taken_for_the_arms():
    """Cameras that stand a little off move every pose alike on the hand; that is the tool's, and its stated scatter
    says so.
    """
    rng = np.random.default_rng(7)
    true = worlds.secret(UR10, rng)
    seen = pose_observations(worlds.tracked(true, UR10, 60, rng, common=(1e-4, 1e-4)))
    found = identify_arm(
        seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, UR10, True, True)
    )
    assert found.shared.shape == (6,) and (np.sqrt(np.diag(found.covariance))[-6:] > 0.9e-4).all()


def test_dependent_columns_are_held_and_named():
    """A target on the last axis cannot tell where around it that axis lies: two figures too many."""
    rng = np.random.default_rng(8)
    true = replace(worlds.secret(UR10, rng), tool=pose([0, 0, 0.1], [0, 0, 0]))
    seen = worlds.touched(true, UR10, 120, rng)
    found = identify_arm(
        seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, UR10, True, True)
    )
    assert found.rank.dependent and found.rank.free.sum() + len(found.rank.dependent) == 27
    assert any("5" in name or "tool" in name for name, _ in found.rank.dependent)
    assert all("remains as stated" in line for line in found.rank.report()[1:])


def test_a_joint_that_never_moved_is_reported():
    rng = np.random.default_rng(9)
    true = worlds.secret(UR10, rng)
    seen = pose_observations(worlds.tracked(true, UR10, 60, rng))
    q = seen.q.copy()
    q[:, 3] = 0.4
    still = replace(
        seen,
        q=q,
        value=arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
        * exp(2e-5 * rng.normal(size=(60, 6))),
    )
    found = identify_arm(
        still, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(still, UR10, True, True)
    )
    assert found.rank.free.sum() < 30 and len(found.rank.report()) > 1


def test_wild_poses_are_left_out():
    rng = np.random.default_rng(10)
    true = worlds.secret(UR10, rng)
    seen = pose_observations(worlds.tracked(true, UR10, 90, rng))
    wild = seen.value.as_matrix()
    wild[[5, 30, 61], :3, 3] += 0.05
    found = identify_arm(
        replace(seen, value=type(seen.value).from_matrix(wild)),
        arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, UR10, True, True),
    )
    assert np.flatnonzero(~found.inliers).tolist() == [5, 30, 61] and not found.scatter.any()


def test_too_few_poses_are_refused():
    rng = np.random.default_rng(11)
    seen = pose_observations(worlds.tracked(worlds.secret(UR10, rng), UR10, 5, rng))
    with pytest.raises(NotEnoughData, match="5 observations give 30 equations, too few for 30"):
        identify_arm(seen, UR10)
    with pytest.raises(NotEnoughData, match="2 observations of a pose"):
        arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(
            seen.take(np.arange(2)), UR10, True, True
        )


def test_a_plan_with_tilt_sensors_states_what_a_fit_then_finds():
    """Standard errors of a plan are those of a fit to poses and tilts measured at its configurations."""
    sensors = (TiltSensor("column", 0, 3e-5, np.zeros(3)), TiltSensor("upper", 2, 3e-5, np.array([-1.57, 0.0, 0.0])))
    gravity, (at, turn) = np.array([0.0, 0.0, -9.81]), (1e-4, 5e-4)
    design = replace(
        design_from_rig_toml.load_design(ROOT / "tests/data/bench/check/rig.toml"), mechanism=UR10, cameras=()
    )
    design = replace(design, tilt_sensors=sensors, gravity=gravity, targets=(), instrument=None)
    planned = plan(design, PlanOptions(count=30, sigma=(at, turn)))
    q = planned.values
    links = mechanism.single_hand_arm_link_frames(q, UR10)[..., :3, :3]
    down = np.tile(gravity / 9.81, (30, 1))
    angles = np.stack([sensor.shown(links[:, sensor.link], down) for sensor in sensors], axis=1)
    noise = np.repeat([at, turn], 3)
    seen = arm_error_model_and_instrument_observations.predicted_target_poses(q, UR10)
    observed = Observations("pose", q, seen, np.tile(np.diag(noise**2), (30, 1, 1)), np.zeros((30, 6, 0)))
    found = identify_arm(replace(observed, tilts=TiltReadings(sensors, angles, down)), UR10)
    without = identify_arm(observed, UR10)
    names = arm_error_model_and_instrument_observations.parameter_names(UR10)
    stated = {
        line.split("urad  ")[1]: float(line.split()[0]) * 1e-6 for line in planned.visibility_lines if "urad  " in line
    }
    compared = [name for name in stated if name in names]
    fitted = [np.sqrt(found.covariance[names.index(name), names.index(name)]) for name in compared]
    assert len(compared) > 2
    np.testing.assert_allclose(fitted, [stated[name] for name in compared], rtol=0.05)
    gained = np.sqrt(np.diag(without.covariance)[found.free] / np.diag(found.covariance)[found.free])
    assert gained.min() > 0.999 and gained.max() > 1.5
