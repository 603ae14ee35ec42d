"""Closed-form and numerical inverse kinematics of arms.

Closed form of six joints (all eight branches), and numerical from many starts.

The frame stands at the crossing of axes 1 and 2 (or where 1 comes nearest to 2), z along axis 1, y along axis 2. It
serves arms whose axes 4, 5, 6 cross (spherical wrist) with 2 parallel to 3, and arms with 2, 3, 4 parallel and 5
crossing 6.
Source: patent CN111488654A. Any other arm: rig.model.mechanisms.arm_kinematics_limits_and_loads.inverse.

Position comes first; rotation is brought as near as the joints' motions that keep the position allow. A calibrated
arm is led in as many directions as its owner's figures give it: in others it moves by a thousandth of what its joints
do, and to make up for a tilt that no joint is there for would take turns of them. Sources: Nakamura, Hanafusa and
Yoshikawa, Task-priority based redundancy control, IJRR 1987; Sugihara, T-RO 2011 (the damping); the lecture on the
manipulator Jacobian: to make up for any error of a pose takes six joints
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms import closed_form_six_joint_inverse_kernels
from rig.model.mechanisms.closed_form_six_joint_inverse_kernels import (
    ELBOW,
    OFF_AXIS,
    SHOULDER,
    TOO_FAR,
    TOO_NEAR,
    TURNED_AWAY,
    WRIST,
)
from rig.model.pose import pose_difference

EXACT = 1e-9  # m and rad; by so much axes may miss what the closed form takes for granted
REASONS = {
    OFF_AXIS: "the wrist would be nearer to axis 1 than the arm's offset allows, by",
    TOO_FAR: "too far, by",
    TOO_NEAR: "too near the shoulder, by",
    TURNED_AWAY: "the wrist cannot point there, by",
}
SINGULAR = {SHOULDER: "shoulder", ELBOW: "elbow", WRIST: "wrist"}


@dataclass(frozen=True, slots=True, eq=False)
class SixJointArm:
    """An arm of six joints as points and space vectors at zero, in its global frame.

    arm : Arm; kind : "spherical" or "parallel"; points, axes : (6, 3) m and unit vectors, each axis's point and
        direction
    key : (3,) m, where the last axes cross; hand : (3, 3) m, points A, B, C of the hand, AB along z and AC along y, 1 m
        each
    frame : T_base_global
    """

    arm: Arm
    kind: str
    points: Floats
    axes: Floats
    key: Floats
    hand: Floats
    frame: RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class InverseBranches:
    """All inverse solutions. q : (..., 8, 6) rad in -pi .. pi, NaN where a branch is not there; exists : (..., 8) bool
    singular : (..., 8) sums of 1 shoulder, 2 elbow, 4 wrist, where two branches meet or a joint is free (then `near`
        was taken)
    reason : (...) 0 or why there is no branch at all (REASONS); gap : (...) m or rad by which it fails."""

    q: Floats
    exists: Booleans
    singular: Integers
    reason: Integers
    gap: Floats

    def why(self, index: int) -> str:
        """A line on pose `index` (of the flat batch): which singularities it touches, or why it cannot be reached."""
        reason = int(self.reason.ravel()[index])
        if reason:
            return f"out of reach: {REASONS[reason]} {self.gap.ravel()[index] * 1e3:.3g} mm or mrad"
        flags = np.bitwise_or.reduce(np.where(self.exists, self.singular, 0).reshape(-1, 8)[index])
        names = [name for bit, name in SINGULAR.items() if flags & bit]
        return f"singular: {', '.join(names)}" if names else "regular"


def closed_form_of_six_joint_arm(arm: Arm) -> SixJointArm:
    """Closed form (SixJointArm) of the inverse kinematics of a six-joint Arm.

    Raises RigError, with the misfit, for any other.
    """
    if arm.couplings:
        raise RigError(f"the closed form is for joints that move alone, and joint {arm.couplings[0].joint + 1} follows")
    if len(arm.joints) != 6:
        raise RigError(f"the closed form is for six joints, not {len(arm.joints)}")
    if arm.slides.any():
        raise RigError(f"the closed form is for joints that turn, and joint {np.flatnonzero(arm.slides)[0] + 1} slides")
    chain = mechanism.single_hand_arm_link_frames(np.zeros(6), arm)
    o, u = chain[:6, :3, 3], chain[:6, :3, 2]
    if np.linalg.norm(np.cross(u[0], u[1])) < EXACT:
        raise RigError("axes 1 and 2 are parallel: the closed form needs a turning base")
    frame = frame_at_first_axes_crossing(arm)
    origin, R = frame.translation, frame.rotation.as_matrix()
    o, u, a = (o - origin) @ R, u @ R, (chain[-1, :3, 3] - origin) @ R
    kind, key = _kind(o, u)
    if np.linalg.norm(np.cross(u[4], u[5])) < EXACT:
        raise RigError("axes 5 and 6 are parallel: there is no wrist to turn")
    return SixJointArm(arm, kind, o, u, key, np.array([a, a + [0, 0, 1], a + [0, 1, 0]]), frame)


def frame_at_first_axes_crossing(arm: Arm) -> RigidTransform:
    """Frame T_base_global of an Arm at the crossing of its axes 1 and 2, z along axis 1, y along axis 2."""
    chain = mechanism.single_hand_arm_link_frames(np.zeros(len(arm.joints)), arm)
    o, u = chain[:2, :3, 3], chain[:2, :3, 2]
    y = u[1] - (u[1] @ u[0]) * u[0]
    if len(arm.joints) < 2 or np.linalg.norm(y) < EXACT:
        return RigidTransform.from_matrix(chain[0])
    y = y / np.linalg.norm(y)
    return RigidTransform.from_components(
        _nearest(o[0], u[0], o[1], u[1]), Rotation.from_matrix(np.column_stack([np.cross(y, u[0]), y, u[0]]))
    )


def _kind(o: Floats, u: Floats) -> tuple[str, Floats]:
    def skewed(i: int, j: int) -> float:
        return float(np.linalg.norm(np.cross(u[i], u[j])))

    key = _nearest(o[5], u[5], o[4], u[4])
    meets = [float(np.linalg.norm(np.cross(key - o[i], u[i]))) for i in (3, 4, 5)]
    if skewed(1, 2) < EXACT and max(meets) < EXACT and skewed(3, 4) > EXACT:
        return "spherical", key
    if max(skewed(1, 2), skewed(1, 3), *meets[1:]) < EXACT and skewed(1, 4) > EXACT:
        return "parallel", key
    raise RigError(
        f"no closed form: axes 2 and 3 are {skewed(1, 2):.3g} rad from parallel, 2 and 4 {skewed(1, 3):.3g} "
        "rad; axis 4 misses the "
        f"crossing of 5 and 6 by {meets[0]:.3g} m, and these each other by {meets[1]:.3g} m; take "
        "rig.model.mechanisms.arm_kinematics_limits_and_loads.inverse"
    )


def _nearest(o: Floats, u: Floats, p: Floats, v: Floats) -> Floats:
    """The point of line (o, u) nearest to line (p, v); o itself where they are parallel."""
    n = np.cross(u, v)
    square = n @ n
    return o + u * (np.cross(p - o, v) @ n / square) if square > EXACT**2 else o


def _hand(matrix: Floats, six: SixJointArm) -> Floats:
    """(..., 3, 3) m, A, B, C of the hand at poses (..., 4, 4), in the global frame."""
    start = mechanism.single_hand_arm_link_frames(np.zeros(6), six.arm)[-1]
    F = six.frame.as_matrix()
    R = F[:3, :3].T @ matrix[..., :3, :3] @ start[:3, :3].T @ F[:3, :3]  # the hand's turn since zero
    a = (matrix[..., :3, 3] - F[:3, 3]) @ F[:3, :3]
    return np.stack([a, a + R[..., 2], a + R[..., 1]], axis=-2)


def closed_form_inverse(
    T_base_platform: RigidTransform, six_arm: SixJointArm, free_joint_values: Floats | None = None
) -> InverseBranches:
    """Inverse kinematics in closed form.

    InverseBranches of poses (...), singular and unreachable ones marked.
    free_joint_values : (6,) rad, zero by default: what a joint takes that a singular pose leaves free
    """
    matrix = T_base_platform.as_matrix()
    shape = matrix.shape[:-2]
    kernel = (
        closed_form_six_joint_inverse_kernels.spherical_wrist_inverse
        if six_arm.kind == "spherical"
        else closed_form_six_joint_inverse_kernels.parallel_axes_inverse
    )
    free_joint_values = np.zeros(6) if free_joint_values is None else np.asarray(free_joint_values, float)
    q, flags, reason, gap = kernel(
        _hand(matrix.reshape(-1, 4, 4), six_arm),
        six_arm.points,
        six_arm.axes,
        six_arm.hand,
        six_arm.key,
        free_joint_values,
    )
    exists = flags >= 0
    return InverseBranches(
        q.reshape(*shape, 8, 6),
        exists.reshape(*shape, 8),
        np.maximum(flags, 0).reshape(*shape, 8),
        reason.reshape(shape),
        gap.reshape(shape),
    )


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


def hand_motion_direction_counts(arm: Arm) -> DirectionCounts:
    """Counts of directions (DirectionCounts) in which an Arm's hand can move.

    Of position and of rotation.
    """
    low, high = arm.limits.T
    J = mechanism.jacobian(np.random.default_rng(0).uniform(low, high, (SAMPLES, len(low))), arm)
    place = int(np.linalg.matrix_rank(J[:, :3], rtol=NONE).max())
    return DirectionCounts(place, int(np.linalg.matrix_rank(J, rtol=NONE).max()) - place)


def nearest_joint_values_remaining_error_and_settled(
    T_base_platform: RigidTransform,
    arm: Arm,
    start: Floats,
    directions: DirectionCounts,
    effective: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, Floats, Booleans]:
    """Joint values q (m, n) nearest to poses, the remaining error (m, 6), and settled (m,) bool.

    Nearest to poses (m,) from a start (m, n).
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


class InverseSolutions(NamedTuple):
    """q : (k, n) rad or m; rest : (k, 6) m and rad, tangent on the right that few joints leave; missed : (m, rad) how
    near the nearest comes.
    """

    q: Floats
    rest: Floats
    missed: tuple[float, float]


def numerical_inverse_solutions(T_base_platform: RigidTransform, arm: Arm, starts: int = STARTS) -> InverseSolutions:
    """Numerical solutions (InverseSolutions) of the inverse of an Arm at one pose.

    From many starts, those within the limits first.
    """
    n, (low, high) = len(arm.joints), arm.limits.T
    begin = np.random.default_rng(0).uniform(low, high, (starts, n))
    many = RigidTransform.from_matrix(np.tile(T_base_platform.as_matrix(), (starts, 1, 1)))
    if n < WHOLE:
        count = hand_motion_direction_counts(arm)
        q, rest, settled = nearest_joint_values_remaining_error_and_settled(many, arm, begin, count)
        place, turn = np.linalg.norm(rest[:, :3], axis=1), np.linalg.norm(rest[:, 3:], axis=1)
        good = settled & (place <= (mechanism.GOOD if count.position == 3 else FAR)) & (turn <= FAR)
    else:
        q, left = mechanism.damped_least_squares_arm_inverse_and_error(many, arm, begin, starts=0)
        rest, place, turn, good = np.zeros((starts, 6)), left, left, left <= mechanism.GOOD
    q = mechanism.nearest_equivalent_angles(q, arm, np.zeros(q.shape))
    order = np.argsort(np.abs(mechanism.signed_limit_excess(q, arm)).max(axis=1) > 0, kind="stable")
    retained = _once(q, [int(k) for k in order if good[k]], arm)
    nearest = int(np.argmin(np.maximum(place, turn)))
    return InverseSolutions(q[retained], rest[retained], (float(place[nearest]), float(turn[nearest])))


def _once(q: Floats, order: list[int], arm: Arm) -> list[int]:
    """Of indices into q (m, n) in an order those that are apart, whole turns aside."""
    retained: list[int] = []
    for k in order:
        if all(np.abs(mechanism.joint_value_difference(q[k], q[other], arm)).max() >= SAME for other in retained):
            retained.append(k)
    return retained
