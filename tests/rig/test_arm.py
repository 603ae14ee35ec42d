"""Serial arms: forward against an outside library, Jacobian against differences, inverse against forward."""

import numpy as np
import pytest

from rig.errors import Unreachable
from rig.mechanisms import arm as mechanism
from rig.mechanisms import of
from rig.pose import difference, log
from tests.numeric import jacobian
from tests.rig.arms import SEVEN, UR10, configurations, random_arm
from tests.rig.pinocchio_arm import poses

ARMS = {"UR10": UR10, "seven": SEVEN, "random": random_arm(np.random.default_rng(5))}


@pytest.mark.parametrize("name", ARMS)
def test_forward_agrees_with_pinocchio(name):
    arm = ARMS[name]
    q = configurations(arm, 10_000, np.random.default_rng(1))
    ours = mechanism.frames(q, arm)[:, -1]
    theirs = poses(arm, q)
    np.testing.assert_allclose(ours[:, :3, 3], theirs[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(ours[:, :3, :3], theirs[:, :3, :3], atol=1e-12)


def test_one_link_is_hand_worked():
    row = np.array([np.pi / 2, 0.3, 0.2, np.pi / 2, 0.0])
    A = mechanism.link(0.0, row)
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
    np.testing.assert_allclose(mechanism.jacobian(q, arm), jacobian(lambda x: log(T.inv() * mechanism.forward(x, arm)), q), atol=1e-8)
    turned = mechanism.jacobian(q, arm, "base").reshape(2, 3, -1)
    np.testing.assert_allclose(T.rotation.as_matrix().T @ turned, mechanism.jacobian(q, arm).reshape(2, 3, -1), atol=1e-14)


@pytest.mark.parametrize("name", ["UR10", "seven"])
def test_inverse_finds_every_pose_within_the_limits(name):
    arm = ARMS[name]
    T = mechanism.forward(configurations(arm, 300, np.random.default_rng(3), 0.95), arm)
    q = of(arm).inverse(T, arm)
    assert (mechanism.limits(q, arm) == 0).all()
    np.testing.assert_allclose(difference(mechanism.forward(q, arm), T), 0, atol=1e-9)


def test_inverse_stays_near_the_guess():
    q = configurations(SEVEN, 200, np.random.default_rng(4), 0.8)
    found = mechanism.inverse(mechanism.forward(q, SEVEN), SEVEN, q + 1e-3)
    assert np.abs(found - q).max() < 0.02


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
    found = mechanism.wrapped(q, UR10, near)
    np.testing.assert_allclose(np.sin(found), np.sin(q), atol=1e-12)
    assert (mechanism.limits(found, UR10) == 0).all() and abs(found[0, 2] - 6.0) < 0.5 and abs(found[0, 5] + 6.0) < 0.5


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"\(\.\.\., 6\) rad, got shape \(7,\)"):
        mechanism.forward(np.zeros(7), UR10)
    with pytest.raises(ValueError, match="finite"):
        mechanism.forward(np.full(6, np.nan), UR10)
