"""Numerical inverse of arms without closed form: solutions from many starts, nearest ones of few joints.

Position comes first; rotation is brought as near as the joints' motions that keep the position allow. A calibrated
arm is led in as many directions as its owner's figures give it: in others it moves by a thousandth of what its joints
do, and to make up for a tilt that no joint is there for would take turns of them. Sources: Nakamura, Hanafusa and
Yoshikawa, Task-priority based redundancy control, IJRR 1987; Sugihara, T-RO 2011 (the damping); the lecture on the
manipulator Jacobian: to make up for any error of a pose takes six joints
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.arrays import Booleans, Floats
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.pose import pose_difference

WHOLE = 6  # joints that reach all directions
NONE = 1e-7  # of the greatest singular value; less is no direction
SAMPLES = 25  # configurations at which an arm's directions are counted
ITERATIONS = 80
SETTLED = 1e-12  # m or rad, of a step
_LONGEST_STEP = 0.5  # m or rad, longest single one


class DirectionCounts(NamedTuple):
    """How many directions of position, and of rotation with the position kept, an arm moves its hand in."""

    position: int
    rotation: int


def reachable_direction_counts(arm: Arm) -> DirectionCounts:
    """DirectionCounts: in how many directions of position and rotation an Arm can move its hand."""
    low, high = arm.limits.T
    J = mechanism.jacobian(np.random.default_rng(0).uniform(low, high, (SAMPLES, len(low))), arm)
    place = int(np.linalg.matrix_rank(J[:, :3], rtol=NONE).max())
    return DirectionCounts(place, int(np.linalg.matrix_rank(J, rtol=NONE).max()) - place)


def nearest_joint_values(
    T_base_platform: RigidTransform,
    arm: Arm,
    start: Floats,
    directions: DirectionCounts,
    effective: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, Floats, Booleans]:
    """Joint values q (m, n) nearest to poses (m,) from a start (m, n), the rest (m, 6), settled (m,) bool.

    directions : Directions in which it may be led; rest : tangent on the right, in the hand, that still leads to the
        pose
    effective : q (m, n) -> values (m, n) that the joints really take, q itself by default
    """
    q, effective = np.array(start, float), effective or (lambda values: values)
    size = np.full(len(q), np.inf)
    for _ in range(ITERATIONS):
        going = size >= SETTLED
        if not going.any():
            break
        J = mechanism.jacobian(effective(q), arm)
        step = _step(J, pose_difference(mechanism.forward(effective(q), arm), T_base_platform), directions)
        size = np.where(going, np.abs(step).max(axis=1), size)
        q = q + np.where(going[:, None], step, 0.0) / np.maximum(1.0, size / _LONGEST_STEP)[:, None]
    return q, pose_difference(mechanism.forward(effective(q), arm), T_base_platform), size < SETTLED


def _step(J: Floats, error: Floats, count: DirectionCounts) -> Floats:
    """(m, n) joints' step of Jacobians (m, 6, n) towards what is missing (m, 6): position first, rotation with what
    keeps it.
    """
    first, keeps = _led(J[:, :3], error[:, :3], count.position)
    if not count.rotation:
        return first
    left = error[:, 3:] - (J[:, 3:] @ first[..., None])[..., 0]
    return first + _led(J[:, 3:] @ keeps, left, count.rotation)[0]


def _led(A: Floats, error: Floats, count: int) -> tuple[Floats, Floats]:
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


STARTS = 64
SAME = 1e-3  # rad or m; solutions nearer to each other are one
FAR = 0.05  # m and rad, that few joints may leave of a pose


class Solutions(NamedTuple):
    """q : (k, n) rad or m; rest : (k, 6) m and rad, tangent on the right that few joints leave; missed : (m, rad) how
    near the nearest comes.
    """

    q: Floats
    rest: Floats
    missed: tuple[float, float]


def inverse_solutions(T_base_platform: RigidTransform, arm: Arm, starts: int = STARTS) -> Solutions:
    """Inverse Solutions of one pose () of an Arm from many starts, those within the limits first."""
    n, (low, high) = len(arm.joints), arm.limits.T
    begin = np.random.default_rng(0).uniform(low, high, (starts, n))
    many = RigidTransform.from_matrix(np.tile(T_base_platform.as_matrix(), (starts, 1, 1)))
    if n < WHOLE:
        count = reachable_direction_counts(arm)
        q, rest, settled = nearest_joint_values(many, arm, begin, count)
        place, turn = np.linalg.norm(rest[:, :3], axis=1), np.linalg.norm(rest[:, 3:], axis=1)
        good = settled & (place <= (mechanism.GOOD if count.position == 3 else FAR)) & (turn <= FAR)
    else:
        q, left = mechanism.solve_inverse(many, arm, begin, starts=0)
        rest, place, turn, good = np.zeros((starts, 6)), left, left, left <= mechanism.GOOD
    q = mechanism.nearest_equivalent_angles(q, arm, np.zeros(q.shape))
    order = np.argsort(np.abs(mechanism.limits(q, arm)).max(axis=1) > 0, kind="stable")
    kept = _once(q, [int(k) for k in order if good[k]], arm)
    nearest = int(np.argmin(np.maximum(place, turn)))
    return Solutions(q[kept], rest[kept], (float(place[nearest]), float(turn[nearest])))


def _once(q: Floats, order: list[int], arm: Arm) -> list[int]:
    """Of indices into q (m, n) in an order those that are apart, whole turns aside."""
    kept: list[int] = []
    for k in order:
        if all(np.abs(mechanism.joint_difference(q[k], q[other], arm)).max() >= SAME for other in kept):
            kept.append(k)
    return kept
