"""Inverse kinematics of six-joint arms in closed form, all eight branches, and forward by hand points.

The frame stands at the crossing of axes 1 and 2 (or where 1 comes nearest to 2), z along axis 1, y along axis 2. It
serves arms whose axes 4, 5, 6 cross (spherical wrist) with 2 parallel to 3, and arms with 2, 3, 4 parallel and 5
crossing 6.
Source: patent CN111488654A. Any other arm: rig.model.mechanisms.arm.inverse.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.arrays import Booleans, Floats, Integers
from rig.errors import RigError, Unreachable
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms import joint_angle_kernels, six_joint_inverse_kernels

EXACT = 1e-9  # m and rad; by so much axes may miss what the closed form takes for granted
REASONS = {
    joint_angle_kernels.OFF_AXIS: "the wrist would stand nearer to axis 1 than the arm's offset allows, by",
    joint_angle_kernels.TOO_FAR: "too far, by",
    joint_angle_kernels.TOO_NEAR: "too near the shoulder, by",
    joint_angle_kernels.TURNED_AWAY: "the wrist cannot point there, by",
}
SINGULAR = {
    joint_angle_kernels.SHOULDER: "shoulder",
    joint_angle_kernels.ELBOW: "elbow",
    joint_angle_kernels.WRIST: "wrist",
}


@dataclass(frozen=True, slots=True, eq=False)
class SixR:
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
class Branches:
    """All inverse solutions. q : (..., 8, 6) rad in -pi .. pi, NaN where a branch is not there; there : (..., 8) bool
    singular : (..., 8) sums of 1 shoulder, 2 elbow, 4 wrist, where two branches meet or a joint is free (then `near`
        was taken)
    reason : (...) 0 or why there is no branch at all (REASONS); gap : (...) m or rad by which it fails."""

    q: Floats
    there: Booleans
    singular: Integers
    reason: Integers
    gap: Floats

    def why(self, index: int) -> str:
        """A line on pose `index` (of the flat batch): which singularities it touches, or why it cannot be reached."""
        reason = int(self.reason.ravel()[index])
        if reason:
            return f"out of reach: {REASONS[reason]} {self.gap.ravel()[index]:.3g} m or rad"
        flags = np.bitwise_or.reduce(np.where(self.there, self.singular, 0).reshape(-1, 8)[index])
        names = [name for bit, name in SINGULAR.items() if flags & bit]
        return f"singular: {', '.join(names)}" if names else "regular"


def six_joint_arm(arm: Arm) -> SixR:
    """Six-joint arm (SixR) of an Arm with a closed form. Raises RigError, with the misfit, for any other."""
    if len(arm.joints) != 6:
        raise RigError(f"the closed form is for six joints, not {len(arm.joints)}")
    if arm.slides.any():
        raise RigError(f"the closed form is for joints that turn, and joint {np.flatnonzero(arm.slides)[0] + 1} slides")
    chain = mechanism.frames(np.zeros(6), arm)
    o, u = chain[:6, :3, 3], chain[:6, :3, 2]
    if np.linalg.norm(np.cross(u[0], u[1])) < EXACT:
        raise RigError("axes 1 and 2 are parallel: the closed form needs a turning base")
    frame = global_frame(arm)
    origin, R = frame.translation, frame.rotation.as_matrix()
    o, u, a = (o - origin) @ R, u @ R, (chain[-1, :3, 3] - origin) @ R
    kind, key = _kind(o, u)
    if np.linalg.norm(np.cross(u[4], u[5])) < EXACT:
        raise RigError("axes 5 and 6 are parallel: there is no wrist to turn")
    return SixR(arm, kind, o, u, key, np.array([a, a + [0, 0, 1], a + [0, 1, 0]]), frame)


def global_frame(arm: Arm) -> RigidTransform:
    """Global frame T_base_global of an Arm: at the crossing of axes 1 and 2, z along axis 1, y along axis 2."""
    chain = mechanism.frames(np.zeros(len(arm.joints)), arm)
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
        "rig.model.mechanisms.arm.inverse"
    )


def _nearest(o: Floats, u: Floats, p: Floats, v: Floats) -> Floats:
    """The point of line (o, u) nearest to line (p, v); o itself where they are parallel."""
    n = np.cross(u, v)
    square = n @ n
    return o + u * (np.cross(p - o, v) @ n / square) if square > EXACT**2 else o


def _hand(matrix: Floats, six: SixR) -> Floats:
    """(..., 3, 3) m, A, B, C of the hand at poses (..., 4, 4), in the global frame."""
    start = mechanism.frames(np.zeros(6), six.arm)[-1]
    F = six.frame.as_matrix()
    R = F[:3, :3].T @ matrix[..., :3, :3] @ start[:3, :3].T @ F[:3, :3]  # the hand's turn since zero
    a = (matrix[..., :3, 3] - F[:3, 3]) @ F[:3, :3]
    return np.stack([a, a + R[..., 2], a + R[..., 1]], axis=-2)


def forward(q: Floats, six: SixR) -> RigidTransform:
    """Forward kinematics: T_base_platform (...) of joint angles q (..., 6) rad, by the hand's points."""
    q = np.asarray(q, float)
    abc = joint_angle_kernels.forward_hand_points(
        np.ascontiguousarray(q.reshape(-1, 6)), six.points, six.axes, six.hand
    )
    y, z = abc[:, 2] - abc[:, 0], abc[:, 1] - abc[:, 0]
    turn = np.stack([np.cross(y, z), y, z], axis=-1)
    F, start = six.frame.as_matrix(), mechanism.frames(np.zeros(6), six.arm)[-1]
    out = np.zeros((len(abc), 4, 4))
    out[:, :3, :3] = F[:3, :3] @ turn @ F[:3, :3].T @ start[:3, :3]
    out[:, :3, 3] = abc[:, 0] @ F[:3, :3].T + F[:3, 3]
    out[:, 3, 3] = 1
    return RigidTransform.from_matrix(out.reshape(*q.shape[:-1], 4, 4))


def inverse(T_base_platform: RigidTransform, six: SixR, near: Floats | None = None) -> Branches:
    """Inverse kinematics in closed form: Branches of poses (...), singular and unreachable ones marked.

    near : (6,) rad, zero by default: what a joint takes that a singular pose leaves free
    """
    matrix = T_base_platform.as_matrix()
    shape = matrix.shape[:-2]
    kernel = (
        six_joint_inverse_kernels.spherical_wrist_inverse
        if six.kind == "spherical"
        else six_joint_inverse_kernels.parallel_axes_inverse
    )
    near = np.zeros(6) if near is None else np.asarray(near, float)
    q, flags, reason, gap = kernel(_hand(matrix.reshape(-1, 4, 4), six), six.points, six.axes, six.hand, six.key, near)
    there = flags >= 0
    return Branches(
        q.reshape(*shape, 8, 6),
        there.reshape(*shape, 8),
        np.maximum(flags, 0).reshape(*shape, 8),
        reason.reshape(shape),
        gap.reshape(shape),
    )


def nearest_solution(T_base_platform: RigidTransform, six: SixR, guess: Floats) -> Floats:
    """Nearest inverse solution (..., 6) rad to a guess, of all branches and turns within the limits.

    Raises Unreachable with the index of poses out of reach, or whose solutions all leave the limits
    """
    found = inverse(T_base_platform, six)
    guess = np.broadcast_to(guess, found.q.shape[:-2] + (6,))
    q = mechanism.nearest_equivalent_angles(found.q, six.arm, guess[..., None, :])
    allowed = found.there & (mechanism.limits(q, six.arm) == 0).all(axis=-1)
    far = np.where(allowed, np.abs(q - guess[..., None, :]).max(axis=-1), np.inf)
    failed = np.flatnonzero(np.isinf(far.min(axis=-1)))
    if len(failed):
        lines = [
            f"pose {i}: {found.why(i) if found.reason.ravel()[i] else 'every solution leaves the joint limits'}"
            for i in failed.tolist()
        ]
        raise Unreachable(f"{len(failed)} of {far[..., 0].size} poses cannot be taken:", failed, lines)
    return np.take_along_axis(q, np.argmin(far, axis=-1)[..., None, None], axis=-2)[..., 0, :]
