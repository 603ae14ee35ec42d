"""An arm with several hands: Jacobians against differences, loads against potential energy, one hand as a plain arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Branch
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import loads_by_weight_of_hands
from rig.model.pose import pose_difference
from tests.rig.arms import UR10
from tests.two_armed import humanoid

STEP = 1e-6
G = np.array([0.0, 1.0, -9.6])


@pytest.fixture(scope="module")
def arm():
    return humanoid().mechanism


@pytest.fixture
def q(arm):
    return np.random.default_rng(4).uniform(*arm.limits.T, (6, 15))


@pytest.mark.parametrize("hand", ["left", "right"])
def test_the_jacobian_of_each_hand_is_the_derivative_of_its_pose(arm, q, hand):
    seen = arm.of_hand(hand)
    J, here = serial.jacobian(q, seen), serial.forward(q, seen)
    for j, step in enumerate(STEP * np.eye(15)):
        low, high = (pose_difference(here, serial.forward(q + sign * step, seen)) for sign in (-1, 1))
        np.testing.assert_allclose(J[..., j], (high - low) / (2 * STEP), atol=1e-8)
    assert seen.moving.tolist() == [True] * 3 + [hand == "left"] * 6 + [hand == "right"] * 6


@pytest.mark.parametrize(("hand", "own"), [("left", range(9)), ("right", [0, 1, 2, *range(9, 15)])])
def test_each_hand_moves_as_an_arm_of_its_own_joints_alone(arm, q, hand, own):
    """The mount between trunk and arm as a tool of the one and the base of the other."""
    mount = next(branch.mount for branch in arm.branches if branch.joint == list(own)[3])
    trunk = Arm(arm.joints[:3], arm.limits[:3], arm.base, mount)
    end = next(one for one in arm.hands if one.name == hand)
    above = Arm(arm.joints[list(own)[3:]], arm.limits[list(own)[3:]], tool=end.tool)
    expected = serial.forward(q[:, :3], trunk) * serial.forward(q[:, list(own)[3:]], above)
    found = serial.forward(q, arm.of_hand(hand))
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-14)


def energy(q, arm, masses):
    """(n,) J, potential energy of the hands and of a mass (joints, 4: kg, and kg m along its frame) of each link."""
    after = serial.joint_frames(q, arm).after
    moments = masses[:, :1] * after[..., :3, 3] + np.einsum("nkij,kj->nki", after[..., :3, :3], masses[:, 1:])
    total = -(moments @ G).sum(axis=1)
    for number, hand in enumerate(arm.hands):
        total -= hand.mass * (serial.forward(q, arm.of_hand(number)).apply(hand.centre_of_mass) @ G)
    return total


def test_joints_hold_the_weight_of_every_branch_that_stands_on_them(arm, q):
    masses = np.random.default_rng(1).uniform(0.5, 2.0, (15, 4)) * [1.0, 0.1, 0.1, 0.1]
    links = serial.link_weight_loads(None, q, arm, G) @ masses.ravel()
    loads = links + loads_by_weight_of_hands(q, arm, np.tile(G, (len(q), 1)))
    for j, step in enumerate(STEP * np.eye(15)):
        slope = (energy(q + step, arm, masses) - energy(q - step, arm, masses)) / (2 * STEP)
        np.testing.assert_allclose(loads[:, j], slope, atol=1e-6)
    one = replace(arm, hands=(arm.hands[0], replace(arm.hands[1], mass=0.0)))
    left = loads_by_weight_of_hands(q, one, np.tile(G, (len(q), 1)))
    assert not left[:, 9:].any() and left[:, :9].all(axis=None)


def test_the_inverse_of_one_hand_leaves_the_joints_of_the_other(arm, q):
    seen, start = arm.of_hand("right"), np.full((6, 15), 0.1)
    found, left = serial.damped_least_squares_arm_inverse_and_error(serial.forward(q, seen), seen, start)
    assert (left < 1e-10).all()
    np.testing.assert_array_equal(found[:, 3:9], start[:, 3:9])


def test_what_is_for_one_hand_refuses_several(arm, q):
    with pytest.raises(RigError, match="requires an arm with one hand; this one has 2"):
        serial.single_hand_arm_link_frames(q, arm)
    with pytest.raises(RigError, match="no hand 'lefd'; there are left, right"):
        arm.of_hand("lefd")
    for number in (-1, 2, 5):
        with pytest.raises(RigError, match=f"no hand number {number}, counted from 0; there are left, right"):
            arm.of_hand(number)
    with pytest.raises(RigError, match="no hand number 0, counted from 0; there are no named hands"):
        UR10.of_hand(0)


@pytest.mark.parametrize("branches", [((3, 5),), ((0, 3),), ((3, 1), (3, 2))])
def test_branches_that_make_no_tree_are_refused(arm, branches):
    none = RigidTransform.identity()
    with pytest.raises(ValueError, match="branch"):
        replace(arm, branches=tuple(Branch(joint, parent, none) for joint, parent in branches))
