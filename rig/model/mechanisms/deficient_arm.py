"""Arms of fewer than six joints: the joint values that bring the hand nearest to a pose, and what of the pose they
leave.

Position comes first; rotation is brought as near as the joints' motions that keep the position allow. A calibrated arm
is led in as many directions as its owner's figures give it: in others it moves by a thousandth of what its joints do,
and to make up for a tilt that no joint is there for would take turns of them.
Sources: Nakamura, Hanafusa and Yoshikawa, Task-priority based redundancy control, IJRR 1987; Sugihara, T-RO 2011 (the
damping); the lecture on the manipulator Jacobian: to make up for any error of a pose takes six joints
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.pose import pose_difference

WHOLE = 6  # joints that reach all directions
NONE = 1e-7  # of the greatest singular value; less is no direction
SAMPLES = 25  # configurations at which an arm's directions are counted
ITERATIONS = 80
SETTLED = 1e-12  # m or rad, of a step
STEP = 0.5  # m or rad, longest single one


class Directions(NamedTuple):
    """How many directions of position, and of rotation with the position kept, an arm moves its hand in."""

    position: int
    rotation: int


def reachable_directions(arm: Arm) -> Directions:
    """Directions of an Arm, at configurations in general."""
    low, high = arm.limits.T
    J = mechanism.jacobian(np.random.default_rng(0).uniform(low, high, (SAMPLES, len(low))), arm)
    place = int(np.linalg.matrix_rank(J[:, :3], rtol=NONE).max())
    return Directions(place, int(np.linalg.matrix_rank(J, rtol=NONE).max()) - place)


def nearest_configuration(
    T_base_platform: RigidTransform,
    arm: Arm,
    start: np.ndarray,
    count: Directions,
    effective: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(q (m, n) rad or m, rest (m, 6) m and rad, settled (m,) bool): joint values from a start (m, n) at which the hand
    is nearest to poses (m,).

    count : Directions in which it may be led; rest : tangent on the right, in the hand, that still leads to the pose
    effective : q (m, n) -> values (m, n) that the joints really take, q itself by default
    """
    q, effective = np.array(start, float), effective or (lambda values: values)
    size = np.full(len(q), np.inf)
    for _ in range(ITERATIONS):
        going = size >= SETTLED
        if not going.any():
            break
        J = mechanism.jacobian(effective(q), arm)
        step = _step(J, pose_difference(mechanism.forward(effective(q), arm), T_base_platform), count)
        size = np.where(going, np.abs(step).max(axis=1), size)
        q = q + np.where(going[:, None], step, 0.0) / np.maximum(1.0, size / STEP)[:, None]
    return q, pose_difference(mechanism.forward(effective(q), arm), T_base_platform), size < SETTLED


def _step(J: np.ndarray, error: np.ndarray, count: Directions) -> np.ndarray:
    """(m, n) joints' step of Jacobians (m, 6, n) towards what is missing (m, 6): position first, rotation with what
    keeps it.
    """
    first, keeps = _led(J[:, :3], error[:, :3], count.position)
    if not count.rotation:
        return first
    left = error[:, 3:] - (J[:, 3:] @ first[..., None])[..., 0]
    return first + _led(J[:, 3:] @ keeps, left, count.rotation)[0]


def _led(A: np.ndarray, error: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(step (m, n) by which A (m, 3, n) makes up for errors (m, 3) in its `count` best directions, (m, n, n) motions
    that do not touch these).
    """
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    U, s, Vt = U[..., :count], s[..., :count], Vt[..., :count, :]
    along = (np.swapaxes(U, 1, 2) @ error[..., None])[..., 0]
    damping = (
        0.5 * (along**2).sum(axis=1, keepdims=True) + 1e-15
    )  # vanishes with the error's square, so the end is Newton's
    step = (np.swapaxes(Vt, 1, 2) @ (s / (s**2 + damping) * along)[..., None])[..., 0]
    return step, np.eye(A.shape[2]) - np.swapaxes(Vt, 1, 2) @ Vt
