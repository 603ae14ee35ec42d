"""Serial arms: forward against an outside library, Jacobian against differences, inverse against forward."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from rig.errors import Unreachable
from rig.model.design import Arm
from rig.model.mechanisms import (
    arm_dynamics_and_step_by_step_kinematics,
    closed_form_and_numerical_arm_inverse,
    kinematics_of,
)
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import exp, log, pose_difference
from tests.numerical_derivatives import jacobian
from tests.rig.arms import GANTRY, SCARA, SEVEN, STANFORD, UR10, configurations, random_arm
from tests.rig.pinocchio_arm import build, poses

ARMS = {
    "UR10": UR10,
    "seven": SEVEN,
    "random": random_arm(np.random.default_rng(5)),
    "scara": SCARA,
    "gantry": GANTRY,
    "stanford": STANFORD,
    "random slides": random_arm(np.random.default_rng(6), 6, (0, 2, 5)),
}


@pytest.mark.parametrize("name", ARMS)
def test_forward_agrees_with_pinocchio(name):
    arm = ARMS[name]
    q = configurations(arm, 10_000, np.random.default_rng(1))
    ours = mechanism.single_hand_arm_link_frames(q, arm)[:, -1]
    theirs = poses(arm, q)
    np.testing.assert_allclose(ours[:, :3, 3], theirs[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(ours[:, :3, :3], theirs[:, :3, :3], atol=1e-12)


def test_one_link_is_hand_worked():
    row = np.array([np.pi / 2, 0.3, 0.2, np.pi / 2, 0.0])
    A = mechanism.link_transform(0.0, row)
    np.testing.assert_allclose(A, [[0, 0, 1, 0], [1, 0, 0, 0.2], [0, 1, 0, 0.3], [0, 0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("shape", [(), (3,), (2, 4)])
def test_batches_keep_their_shape(shape):
    q = np.zeros((*shape, 7)) + 0.3
    assert mechanism.forward(q, SEVEN).shape == shape and mechanism.jacobian(q, SEVEN).shape == (*shape, 6, 7)
    assert mechanism.inverse(mechanism.forward(q, SEVEN), SEVEN, q).shape == (*shape, 7)


@pytest.mark.parametrize("name", ARMS)
def test_jacobian_agrees_with_differences(name):
    arm = ARMS[name]
    q = configurations(arm, 1, np.random.default_rng(2))[0]
    T = mechanism.forward(q, arm)
    np.testing.assert_allclose(
        mechanism.jacobian(q, arm), jacobian(lambda x: log(T.inv() * mechanism.forward(x, arm)), q), atol=1e-8
    )
    turned = mechanism.jacobian(q, arm, "base").reshape(2, 3, -1)
    np.testing.assert_allclose(
        T.rotation.as_matrix().T @ turned, mechanism.jacobian(q, arm).reshape(2, 3, -1), atol=1e-14
    )


@pytest.mark.parametrize("name", ["UR10", "seven", "scara", "gantry", "stanford"])
def test_inverse_finds_every_pose_within_the_limits(name):
    arm = ARMS[name]
    T = mechanism.forward(configurations(arm, 300, np.random.default_rng(3), 0.95), arm)
    q = kinematics_of(arm).inverse(T, arm)
    assert (mechanism.signed_limit_excess(q, arm) == 0).all()
    np.testing.assert_allclose(pose_difference(mechanism.forward(q, arm), T), 0, atol=1e-9)


def test_inverse_stays_near_the_guess():
    q = configurations(SEVEN, 200, np.random.default_rng(4), 0.8)
    found = mechanism.inverse(mechanism.forward(q, SEVEN), SEVEN, q + 1e-3)
    assert np.abs(found - q).max() < 0.02


@pytest.mark.slow
def test_a_pose_out_of_reach_is_named():
    T = mechanism.forward(np.full((3, 6), 0.4), UR10)
    far = T.as_matrix()
    far[1, :3, 3] *= 10
    with pytest.raises(Unreachable, match="1 of 3 poses") as caught:
        mechanism.inverse(type(T).from_matrix(far), UR10)
    assert caught.value.index.tolist() == [1] and "pose 1" in str(caught.value)


def test_angles_are_wrapped_into_the_limits_near_the_guess():
    q = np.array([[7.0, -7.0, -0.1, 0.2, 12.0, 0.0]])
    near = np.array([[0.0, 0.0, 6.0, 0.0, 0.0, -6.0]])
    found = mechanism.nearest_equivalent_angles(q, UR10, near)
    np.testing.assert_allclose(np.sin(found), np.sin(q), atol=1e-12)
    assert (
        (mechanism.signed_limit_excess(found, UR10) == 0).all()
        and abs(found[0, 2] - 6.0) < 0.5
        and abs(found[0, 5] + 6.0) < 0.5
    )


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"\(\.\.\., 6\) rad, got shape \(7,\)"):
        mechanism.forward(np.zeros(7), UR10)
    with pytest.raises(ValueError, match="finite"):
        mechanism.forward(np.full(6, np.nan), UR10)


@pytest.mark.parametrize("name", ["stanford", "random slides"])
def test_weight_and_motion_of_slides_agree_with_pinocchio(name):
    """Torques and forces of an arm that moves; at rest the regressor of its links says the same."""
    rng, arm = np.random.default_rng(9), ARMS[name]
    half = rng.normal(size=(6, 3, 3))
    own = arm_dynamics_and_step_by_step_kinematics.LinkMasses(
        rng.uniform(1, 4, 6), 0.1 * rng.normal(size=(6, 3)), 0.01 * half @ np.swapaxes(half, 1, 2)
    )
    model, _ = build(arm)
    for i, row in enumerate(arm.rows):
        to_link = pinocchio.SE3(
            pinocchio.utils.rotate("x", row[3]) @ pinocchio.utils.rotate("y", row[4]), np.array([row[2], 0, 0])
        )
        model.appendBodyToJoint(i + 1, pinocchio.Inertia(own.mass[i], own.centre[i], own.inertia[i]), to_link)
    gravity = np.array([1.0, -2.0, -9.5])
    model.gravity.linear = gravity
    q, v, a = rng.normal(size=(3, 20, 6))
    theirs = [pinocchio.rnea(model, model.createData(), *state) for state in zip(q, v, a)]
    np.testing.assert_allclose(
        arm_dynamics_and_step_by_step_kinematics.joint_torques(q, v, a, arm, own, gravity), theirs, atol=1e-10
    )
    moments = np.column_stack([own.mass, own.mass[:, None] * own.centre]).ravel()
    still = arm_dynamics_and_step_by_step_kinematics.joint_torques(q, 0 * v, 0 * a, arm, own, gravity)
    np.testing.assert_allclose(
        mechanism.link_weight_loads(mechanism.forward(q, arm), q, arm, gravity) @ moments, still, atol=1e-10
    )


def test_a_link_that_grows_takes_its_slide_along():
    """Shares of offsets and lengths, as the pose of the arm with them says."""
    rng, arm = np.random.default_rng(10), ARMS["random slides"]
    q, share = rng.normal(size=(5, 6)), 1e-7 * rng.normal(size=(5, 6))
    T = mechanism.forward(q, arm)
    deviation, sway = mechanism.axis_deviation_and_sway_by_member_growth(T, q, arm, share)
    assert not deviation.any()
    for k in range(5):
        rows = arm.rows.copy()
        rows[:, 1:3] *= 1 + share[k, :, None]
        grown = Arm(rows, arm.limits, arm.base, arm.tool, arm.slides)
        expected = mechanism.forward(np.where(arm.slides, q[k] * (1 + share[k]), q[k]), grown)
        np.testing.assert_allclose(log(T[k].inv() * expected), sway[k], atol=1e-12)


@pytest.mark.parametrize("name, reached", [("scara", (0, 1, 2, 5)), ("gantry", (0, 1, 2))])
def test_few_joints_come_as_near_as_they_can_and_say_what_is_left(name, reached):
    """What an arm's directions can make up for is made up for, to rounding; the rest is left as it was asked for."""
    arm, rng = ARMS[name], np.random.default_rng(11)
    q = configurations(arm, 200, rng, 0.7)
    q[:, 1] = np.abs(q[:, 1]) + 0.7  # not stretched
    count = closed_form_and_numerical_arm_inverse.hand_motion_direction_counts(arm)
    assert count == (3, len(reached) - 3)
    off = np.zeros((200, 6))
    off[:, [3, 4]] = 2e-3 * rng.normal(size=(200, 2))
    requested = 1e-2 * np.eye(6)[list(reached)].T @ rng.normal(size=(len(reached), 200))
    wanted = mechanism.forward(q, arm) * exp(requested.T) * exp(off)
    found, rest, settled = closed_form_and_numerical_arm_inverse.nearest_joint_values_remaining_error_and_settled(
        wanted, arm, q, count
    )
    assert settled.all() and np.abs(rest[:, :3]).max() < 1e-12
    np.testing.assert_allclose(pose_difference(mechanism.forward(found, arm), wanted), rest, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rest[:, 3:], axis=1), np.linalg.norm(off[:, 3:], axis=1), atol=1e-5)
    beyond = replace(
        arm, joints=arm.rows + 1e-3 * rng.normal(size=arm.rows.shape)
    )  # askew: no direction more to be led in
    found, rest, settled = closed_form_and_numerical_arm_inverse.nearest_joint_values_remaining_error_and_settled(
        wanted, beyond, q, count
    )
    assert settled.all() and np.abs(rest[:, :3]).max() < 1e-12 and np.abs(found - q).max() < 0.4


@pytest.mark.slow
def test_an_arm_of_few_joints_has_no_joint_values_for_a_pose_it_cannot_take():
    T = mechanism.forward(np.array([[0.3, 0.4, 0.1, 0.2]]), SCARA)
    with pytest.raises(Unreachable, match="no nearer"):
        mechanism.inverse(T * exp(np.array([0, 0, 0, 0.01, 0, 0])), SCARA)


def test_whole_turns_are_of_joints_that_turn():
    found = mechanism.nearest_equivalent_angles(np.array([7.0, -7.0, 7.0, 7.0]), SCARA, np.zeros(4))
    np.testing.assert_allclose(found, [7 - 2 * np.pi, 2 * np.pi - 7, 7.0, 7 - 2 * np.pi])
