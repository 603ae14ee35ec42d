"""Arm of any number of joints: forward and inverse kinematics, Jacobians, limits and loads.

Joints turn or slide.

Distal Denavit-Hartenberg with Hayati's extra turn: A_i = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta), of a slide
Rz(theta) Tz(d + q) ..
Joint values q are rad, of slides m.
Sources: Denavit and Hartenberg 1955; Hayati, Robot arm geometric link parameter estimation, CDC 1983.
"""

from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError, Unreachable
from rig.model.arm_hands_effect_places_and_tolerances import joint_carries_joint_matrix
from rig.model.mechanism_geometry_classes import Arm

AXIS, UNIT = "joint", "rad"
TOLERANCE = 1e-12  # m and rad; what the iteration leaves of a pose
GOOD = 1e-10  # m and rad; what counts as solved: a pose given to 1e-12 at the edge of the reach keeps 1e-6 rad of play
MAX_ITERATIONS = 80
STARTS = 40  # random configurations tried where the guess leads nowhere
REACH = 1.0  # m; a radian counts like so much


def single_hand_arm_link_frames(q: Floats, arm: Arm) -> Floats:
    """Link frames (..., n + 2, 4, 4) of an arm with a single hand at joint values: 0..n and the platform's.

    q : (..., n) rad, of slides m. Frame i - 1 carries axis i (its z). Raises ValueError for another number of joints or
        values not finite, RigError for an arm with several hands
    """
    if arm.hands or arm.branches:
        raise RigError(f"this requires an arm with one hand; this one has {len(arm.hands)}")
    links = _links(q, arm)
    out = np.empty((*links.shape[:-3], len(arm.joints) + 2, 4, 4))
    out[..., 0, :, :] = arm.base.as_matrix()
    for i in range(len(arm.joints)):
        np.matmul(out[..., i, :, :], links[..., i, :, :], out=out[..., i + 1, :, :])
    out[..., -1, :, :] = out[..., -2, :, :] @ arm.tool.as_matrix()
    return out


def _links(q: Floats, arm: Arm) -> Floats:
    """Transforms (..., n, 4, 4) of the links at joint values q (..., n) rad or m. Raises ValueError as
    `single_hand_arm_link_frames`"""
    q = np.asarray(q, float)
    if q.shape[-1:] != (len(arm.joints),) or not np.isfinite(q).all():
        raise ValueError(
            f"expected finite joint angles (..., {len(arm.joints)}) "
            f"{'rad or m' if arm.slides.any() else 'rad'}, got shape {q.shape}"
        )
    q = arm.with_followers(q)
    links = link_transform(joint_values_with_zero_for_slides(q, arm), arm.rows.T)
    if arm.slides.any():
        links[..., 2, 3] += np.where(arm.slides, q, 0.0)
    return links


class JointFrames(NamedTuple):
    """before : (..., n, 4, 4) frames that carry the joints' axes, their z; after : (..., n, 4, 4) of the links that the
    joints move; tip : (..., 4, 4) of the hand
    """

    before: Floats
    after: Floats
    tip: Floats


def joint_frames(q: Floats, arm: Arm) -> JointFrames:
    """JointFrames of an arm of one hand or several at joint values q (..., n) rad or m."""
    if not (arm.branches or arm.hands):
        chain = single_hand_arm_link_frames(q, arm)
        return JointFrames(chain[..., :-2, :, :], chain[..., 1:-1, :, :], chain[..., -1, :, :])
    links = _links(q, arm)
    before, after = np.empty_like(links), np.empty_like(links)
    mounts = {branch.joint: branch.mount.as_matrix() for branch in arm.branches}
    for i, parent in enumerate(arm.parents.tolist()):
        start = arm.base.as_matrix() if parent < 0 else after[..., parent, :, :]
        before[..., i, :, :] = start @ mounts[i] if i in mounts else start
        np.matmul(before[..., i, :, :], links[..., i, :, :], out=after[..., i, :, :])
    last = arm.hands[arm.hand].joint if arm.hands else len(arm.joints) - 1
    return JointFrames(before, after, after[..., last, :, :] @ arm.tool.as_matrix())


def evaluate_with_hand_of_each_row(
    function: Callable[[Floats, Arm], Floats], q: Floats, arm: Arm, hand: Integers | None
) -> Floats:
    """Values (m, ..) of a function of (q, arm), evaluated at each row of q (m, n) with that row's hand (m,).

    hand : None evaluates with the arm as it is
    """
    if hand is None or not len(hand):
        return function(q, arm)
    parts = [(hand == k, function(q[hand == k], arm.of_hand(int(k)))) for k in np.unique(hand)]
    out = np.empty((len(hand), *parts[0][1].shape[1:]))
    for rows, part in parts:
        out[rows] = part
    return out


def hand_pose_of_each_row(q: Floats, arm: Arm, hand: Integers | None) -> RigidTransform:
    """Poses (m,) of the hand (m,) of each row of joint values q (m, n); of the arm as it is where None."""
    return RigidTransform.from_matrix(
        evaluate_with_hand_of_each_row(lambda own, one: joint_frames(own, one).tip, q, arm, hand)
    )


def joint_values_with_zero_for_slides(q: Floats, arm: Arm) -> Floats:
    """Joint values (..., n) rad with zero for slides, the turn angles of the joints at q (..., n)."""
    q = arm.with_followers(q)
    return np.where(arm.slides, 0.0, q) if arm.slides.any() else np.asarray(q, float)


def link_transform(q: Floats, dh_row: Floats) -> Floats:
    """Transform (..., 4, 4) of a link by its Denavit-Hartenberg row.

    dh_row : theta, d, a, alpha, beta; q (...,)
    """
    theta, d, a, alpha, beta = dh_row
    ct, st = np.cos(q + theta), np.sin(q + theta)
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    A = np.zeros((*np.shape(q), 4, 4))
    A[..., 0, 0], A[..., 0, 1], A[..., 0, 2], A[..., 0, 3] = (
        ct * cb - st * sa * sb,
        -st * ca,
        ct * sb + st * sa * cb,
        a * ct,
    )
    A[..., 1, 0], A[..., 1, 1], A[..., 1, 2], A[..., 1, 3] = (
        st * cb + ct * sa * sb,
        ct * ca,
        st * sb - ct * sa * cb,
        a * st,
    )
    A[..., 2, 0], A[..., 2, 1], A[..., 2, 2], A[..., 2, 3] = -ca * sb, sa, ca * cb, d
    A[..., 3, 3] = 1
    return A


def forward(q: Floats, arm: Arm, guess: RigidTransform | None = None) -> RigidTransform:
    """Forward kinematics: T_base_platform (...) of joint values q (..., n) rad or m. guess : unused."""
    return RigidTransform.from_matrix(joint_frames(q, arm).tip)


def jacobian(q: Floats, arm: Arm, output_axes: str = "platform") -> Floats:
    """Jacobian (..., 6, n) of the platform's linear, then angular velocity by the joint rates.

    q : (..., n) rad or m; output_axes : "platform", the tangent on the right, or "base", the axes in which poses are
        given
    Source: Whitney 1972; the columns are z x (p - o) over z, of a slide z over 0
    Raises ValueError for other axes.
    """
    if output_axes not in ("platform", "base"):
        raise ValueError(f"axes must be 'platform' or 'base', not {output_axes!r}")
    return geometric_jacobian(joint_frames(q, arm), arm, output_axes)


def geometric_jacobian(frames: JointFrames, arm: Arm, output_axes: str = "platform") -> Floats:
    """Geometric Jacobian (..., 6, n) of an arm from its joint frames."""
    z, o = frames.before[..., :3, 2], frames.before[..., :3, 3]
    J = np.concatenate([np.cross(z, frames.tip[..., None, :3, 3] - o), z], axis=-1)
    if arm.slides.any():
        J[..., arm.slides, :3], J[..., arm.slides, 3:] = z[..., arm.slides, :], 0.0
    if arm.hands:
        J[..., ~arm.moving, :] = 0.0
    if output_axes == "platform":
        R = frames.tip[..., :3, :3]
        J = np.concatenate([J[..., :3] @ R, J[..., 3:] @ R], axis=-1)
    if arm.couplings:
        J = arm.motion_by_command.T @ J
    return np.swapaxes(J, -1, -2)


def signed_limit_excess(q: Floats, arm: Arm) -> Floats:
    """Excess of joint values over their limits, (..., n) rad or m.

    Negative below, positive above, 0 inside.
    """
    low, high = arm.limits.T
    return np.minimum(q - low, 0) + np.maximum(q - high, 0)


def travel_ranges(arm: Arm) -> Floats:
    """Travel (n, 2) rad or m of the joints.

    Their limits.
    """
    return arm.limits


def home_values(arm: Arm) -> Floats:
    """Home joint values (n,) rad or m.

    All zero.
    """
    return np.zeros(len(arm.joints))


def axis_forces_and_torques(T: RigidTransform, q: Floats, arm: Arm, wrench: Floats) -> Floats:
    """Forces (slides) and torques (m, n) N, N m of the joints that hold a wrench (m, 6) on the hand."""
    return -np.einsum("mij,mi->mj", jacobian(q, arm), wrench)


def link_weight_loads(T: RigidTransform, q: Floats, arm: Arm, gravity: Floats) -> Floats:
    """Loads (m, n, 4 n) N m of the links' own weight on the joints.

    Per kg and kg m of each link.
    gravity : (3,), or (m, 3) of each posture, m/s^2 in the frame of poses
    Source: Luh, Walker and Paul's recursion at rest, as a regressor: Gautier and Khalil 1990
    """
    frames, n, carries = joint_frames(q, arm), len(arm.joints), joint_carries_joint_matrix(arm.parents)
    z, start, o = frames.before[..., :3, 2], frames.before[..., :3, 3], frames.after[..., :3, 3]
    out = np.zeros((len(z), n, n, 4))
    down = np.broadcast_to(gravity, (len(z), 3))
    tipped = np.cross(np.swapaxes(frames.after[..., :3, :3], 2, 3), down[:, None, None])  # (m, link, its axis, 3)
    for j in range(n):
        links = carries[j]
        if arm.slides[j]:
            out[:, j, links, 0] = -(z[:, j] * down).sum(axis=1)[:, None]
            continue
        lever = o[:, links] - start[:, [j]]
        out[:, j, links, 0] = -np.einsum("mki,mi->mk", np.cross(lever, down[:, None]), z[:, j])
        out[:, j, links, 1:] = -np.einsum("mkai,mi->mka", tipped[:, links], z[:, j])
    if arm.couplings:  # a leader bears what its followers bear, by their motion
        out = np.einsum("ji,mjkc->mikc", arm.motion_by_command, out)
    return out.reshape(len(z), n, 4 * n)


def link_weight_base_moments(q: Floats, arm: Arm, gravity: Floats) -> Floats:
    """Moments (m, 3, 4 n) N m of the links' own weight about the base's origin.

    Per kg and kg m of each link.
    gravity : (m, 3) m/s^2 of each posture; both in the frame of poses
    """
    after, n = joint_frames(q, arm).after, len(arm.joints)
    out = np.empty((len(after), n, 4, 3))
    out[:, :, 0] = np.cross(after[..., :3, 3] - arm.base.translation, gravity[:, None])
    out[:, :, 1:] = np.cross(np.swapaxes(after[..., :3, :3], 2, 3), gravity[:, None, None])
    return np.moveaxis(out.reshape(len(after), 4 * n, 3), 2, 1)


def axis_deviation_and_sway_by_member_growth(
    T: RigidTransform, q: Floats, arm: Arm, share: Floats
) -> tuple[Floats, Floats]:
    """Axis deviation (m, n) and sway (m, 6) by growth of members: lengths d and a of links by shares (m, n).
    A slide's scale is its travel with it.
    """
    frames, rows = joint_frames(q, arm), arm.rows
    before, turn = frames.before[..., :3, :], (joint_values_with_zero_for_slides(q, arm) + rows[:, 0])[..., None]
    along = np.cos(turn) * before[..., 0] + np.sin(turn) * before[..., 1]  # the common normal
    offset = rows[:, 1] + np.where(arm.slides, arm.with_followers(q), 0.0)
    moved = np.einsum("mn,mni->mi", share * arm.moving, offset[..., None] * before[..., 2] + rows[:, 2, None] * along)
    return np.zeros(share.shape), np.pad((moved[:, None] @ frames.tip[:, :3, :3])[:, 0], ((0, 0), (0, 3)))


def inverse_kinematics_jacobian(T: RigidTransform, q: Floats, arm: Arm) -> Floats:
    """Jacobian (m, n, 6) of inverse kinematics.

    Least change of joint values with the pose's tangent.
    q : (m, n) rad or m
    """
    return np.asarray(np.linalg.pinv(jacobian(q, arm)))


def jacobian_rows_by_axis(T: RigidTransform, q: Floats, arm: Arm) -> Floats:
    """Rows (m, n, 6) of the Jacobian, one for each joint, at joint values q (m, n).

    They are its columns, which coincide where the arm is singular.
    """
    return np.swapaxes(jacobian(q, arm), 1, 2)


def link_points(q: Floats, arm: Arm) -> Floats:
    """Points (..., n + 2, 3) m of the links at joint values q (..., n), in the frame of poses.

    Of several hands the line goes from the base to each in turn, and back
    """
    if not arm.hands:
        return single_hand_arm_link_frames(q, arm)[..., :3, 3]
    ways = []
    for number in range(len(arm.hands)):
        seen = arm.of_hand(number)
        frames, moving = joint_frames(q, seen), seen.moving
        along = np.stack([part[..., :3, 3][..., moving, :] for part in (frames.before, frames.after)], axis=-2)
        base = np.broadcast_to(arm.base.translation, (*along.shape[:-3], 1, 3))
        points = [base, along.reshape(*along.shape[:-3], -1, 3), frames.tip[..., None, :3, 3]]
        ways += [*points, *(part[..., ::-1, :] for part in points[1::-1])]
    return np.concatenate(ways, axis=-2)


def strut_ends(T: RigidTransform, arm: Arm) -> None:
    """None: an arm has no strut ends."""
    return None


def inverse(T_base_platform: RigidTransform, arm: Arm, guess: Floats | None = None) -> Floats:
    """Inverse kinematics: joint values (..., n) rad or m of a pose, within limits if possible, near the guess.

    T_base_platform : RigidTransform (...); guess : (n,) or (..., n) rad or m, the middle of the limits by default
    Raises Unreachable with the index of poses to which no start leads, and how near (m, rad) the arm comes
    """
    q, left = damped_least_squares_arm_inverse_and_error(T_base_platform, arm, guess)
    failed = np.flatnonzero(np.ravel(left) > GOOD)
    if len(failed):
        lines = [f"pose {i}: the arm comes no nearer than {np.ravel(left)[i] * 1e3:.3g} mm or mrad" for i in failed]
        raise Unreachable(f"{len(failed)} of {left.size} poses are out of the arm's reach:", failed, lines)
    return q


def damped_least_squares_arm_inverse_and_error(
    T_base_platform: RigidTransform, arm: Arm, guess: Floats | None = None, starts: int = STARTS, seed: int = 0
) -> tuple[Floats, Floats]:
    """Joint values for poses, and the errors left, by damped least squares from a guess, then random starts.

    left : greater of the position's (m) and rotation's (rad) remaining error; above GOOD means no solution was found
    A solution outside the limits is only given where no start leads to one inside.
    Returns (q, error left)
    Source: Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method, T-RO 2011 (the
        damping)
    """
    target = T_base_platform.as_matrix()
    shape, n = target.shape[:-2], len(arm.joints)
    target = target.reshape(-1, 4, 4)
    guess = arm.limits.mean(axis=1) if guess is None else np.asarray(guess, float)
    best = np.broadcast_to(guess, (*shape, n)).reshape(-1, n).copy()
    guess = best.copy()
    left, outside = np.full(len(best), np.inf), np.ones(len(best), bool)
    rng = np.random.default_rng(seed)
    trying = best.copy()
    for _ in range(starts + 1):
        todo = np.flatnonzero((left > GOOD) | outside)
        if not len(todo):
            break
        q, error = _descend(trying[todo], target[todo], arm)
        q = nearest_equivalent_angles(q, arm, guess[todo])
        out = cast(Booleans, (np.abs(signed_limit_excess(q, arm)) > 0).any(axis=1))
        solved, had = error <= GOOD, left[todo] <= GOOD
        better = np.where(solved & had, outside[todo] & ~out, np.where(solved | had, solved, error < left[todo]))
        best[todo[better]], left[todo[better]], outside[todo[better]] = q[better], error[better], out[better]
        trying = np.where(arm.moving, rng.uniform(arm.limits[:, 0], arm.limits[:, 1], best.shape), guess)
    return arm.with_followers(best).reshape(*shape, n), left.reshape(shape)


def nearest_equivalent_angles(q: Floats, arm: Arm, reference: Floats) -> Floats:
    """Equivalent angles (..., n), by whole turns in the limits, nearest to a reference; slides, coupled joints stay."""
    if arm.slides.any() or arm.couplings:  # a whole turn of a leader is none of its followers
        out, turning = np.array(arm.with_followers(q), float), ~arm.slides & ~arm.coupled
        near = np.broadcast_to(reference, out.shape)[..., turning]
        out[..., turning] = _equivalent_angles(out[..., turning], arm.limits[turning], near)
        return out
    return _equivalent_angles(q, arm.limits, reference)


def _equivalent_angles(q: Floats, limits: Floats, reference: Floats) -> Floats:
    """The same of joints that all turn. limits : (n, 2) rad"""
    low, high = limits.T
    turn = 2 * np.pi
    q = q - turn * np.round((q - reference) / turn)
    q = np.where(q > high, q - turn * np.ceil((q - high) / turn), q)
    q = np.where(q < low, q + turn * np.ceil((low - q) / turn), q)
    return np.where(q > high, q - turn * np.round((q - reference) / turn), q)


def joint_value_difference(q: Floats, reference: Floats, arm: Arm) -> Floats:
    """Difference (..., n) rad (slides: m) of joint values q from others, whole turns removed."""
    away = np.asarray(q, float) - reference
    return away - np.where(arm.slides, 0.0, 2 * np.pi * np.round(away / (2 * np.pi)))


def _descend(q: Floats, target: Floats, arm: Arm) -> tuple[Floats, Floats]:
    """(q, error): Levenberg-Marquardt on the pose error of a flat batch, damped by the error's own size."""
    q = q.copy()
    error = np.full(len(q), np.inf)
    going = np.arange(len(q))
    for _ in range(MAX_ITERATIONS):
        frames = joint_frames(q[going], arm)
        e = _twist(frames.tip, target[going])
        error[going] = np.maximum(np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1))
        rest = error[going] > TOLERANCE
        if not rest.any():
            break
        going, frames, e = going[rest], JointFrames(*(part[rest] for part in frames)), e[rest]
        J = geometric_jacobian(frames, arm)
        damping = 0.5 * (e**2).sum(axis=1) + 1e-15  # vanishes with the error's square, so the end is Newton's
        if J.shape[-1] <= 6:
            step = np.linalg.solve(
                np.swapaxes(J, 1, 2) @ J + damping[:, None, None] * np.eye(J.shape[-1]),
                np.swapaxes(J, 1, 2) @ e[..., None],
            )[..., 0]
        else:
            step = (
                np.swapaxes(J, 1, 2)
                @ np.linalg.solve(J @ np.swapaxes(J, 1, 2) + damping[:, None, None] * np.eye(6), e[..., None])
            )[..., 0]
        q[going] += step / np.maximum(1.0, np.abs(step).max(axis=1) / REACH)[:, None]
    return q, error


def _twist(now: Floats, target: Floats) -> Floats:
    """(m, 6) tangent on the right, translation first, that leads from now to target (m, 4, 4), parts taken
    separately.
    """
    R = np.swapaxes(now[:, :3, :3], 1, 2)
    move = (R @ (target[:, :3, 3:] - now[:, :3, 3:]))[..., 0]
    return np.concatenate([move, Rotation.from_matrix(R @ target[:, :3, :3]).as_rotvec()], axis=1)
