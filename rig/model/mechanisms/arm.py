"""Arm of any number of joints.

Turning or sliding joints: forward and inverse kinematics, Jacobian, limits, loads.

Distal Denavit-Hartenberg with Hayati's extra turn: A_i = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta), of a slide
Rz(theta) Tz(d + q) ..
Joint values q are rad, of slides m.
Sources: Denavit and Hartenberg 1955; Hayati, Robot arm geometric link parameter estimation, CDC 1983.
"""

from dataclasses import replace
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats
from rig.errors import Unreachable
from rig.model.mechanism_geometry_classes import Arm

AXIS, UNIT = "joint", "rad"
TOLERANCE = 1e-12  # m and rad; what the iteration leaves of a pose
GOOD = 1e-10  # m and rad; what counts as solved: a pose given to 1e-12 at the edge of the reach keeps 1e-6 rad of play
MAX_ITERATIONS = 80
STARTS = 40  # random configurations tried where the guess leads nowhere
REACH = 1.0  # m; a radian counts like so much


def link_frames(q: Floats, arm: Arm) -> Floats:
    """Frames (..., n + 2, 4, 4) of the arm's links at joint values.

    Frames 0..n and the platform's.
    q : (..., n) rad, of slides m. Frame i - 1 carries axis i (its z). Raises ValueError for another number of joints or
        values not finite
    """
    q = np.asarray(q, float)
    if q.shape[-1:] != (len(arm.joints),) or not np.isfinite(q).all():
        raise ValueError(
            f"expected finite joint angles (..., {len(arm.joints)}) "
            f"{'rad or m' if arm.slides.any() else 'rad'}, got shape {q.shape}"
        )
    out = np.empty((*q.shape[:-1], len(arm.joints) + 2, 4, 4))
    out[..., 0, :, :] = arm.base.as_matrix()
    links = link_transform(joint_values_with_zero_for_slides(q, arm), arm.rows.T)
    if arm.slides.any():
        links[..., 2, 3] += np.where(arm.slides, q, 0.0)
    for i in range(q.shape[-1]):
        np.matmul(out[..., i, :, :], links[..., i, :, :], out=out[..., i + 1, :, :])
    out[..., -1, :, :] = out[..., -2, :, :] @ arm.tool.as_matrix()
    return out


def joint_values_with_zero_for_slides(q: Floats, arm: Arm) -> Floats:
    """Joint values (..., n) rad with zero for slides.

    Turn angles of the joints at joint values q (..., n).

    0 for slides.
    """
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
    """Forward kinematics.

    T_base_platform (...) of joint values q (..., n) rad or m.
    guess : unused.
    """
    return RigidTransform.from_matrix(link_frames(q, arm)[..., -1, :, :])


def jacobian(q: Floats, arm: Arm, output_axes: str = "platform") -> Floats:
    """Jacobian (..., 6, n) of the platform's velocity over its turning rate with the joint values.

    q : (..., n) rad or m; output_axes : "platform", the tangent on the right, or "base", the axes in which poses are
        given
    Source: Whitney 1972; the columns are z x (p - o) over z, of a slide z over 0
    Raises ValueError for other axes.
    """
    if output_axes not in ("platform", "base"):
        raise ValueError(f"axes must be 'platform' or 'base', not {output_axes!r}")
    return geometric_jacobian(link_frames(q, arm), output_axes, arm.slides)


def geometric_jacobian(matrices: Floats, output_axes: str = "platform", slides: Booleans | None = None) -> Floats:
    """Geometric Jacobian (..., 6, n) of link frames (..., n + 2, 4, 4).

    slides : (n,) bool, none by default
    """
    z, o = matrices[..., :-2, :3, 2], matrices[..., :-2, :3, 3]
    J = np.concatenate([np.cross(z, matrices[..., -1:, :3, 3] - o), z], axis=-1)
    if slides is not None and slides.any():
        J[..., slides, :3], J[..., slides, 3:] = z[..., slides, :], 0.0
    if output_axes == "platform":
        R = matrices[..., -1, :3, :3]
        J = np.concatenate([J[..., :3] @ R, J[..., 3:] @ R], axis=-1)
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


def axis_loads(T: RigidTransform, q: Floats, arm: Arm, wrench: Floats) -> Floats:
    """Axis loads (m, n) N m (slides: N) of the joints that hold a wrench.

    A wrench (m, 6) on the platform.
    """
    return -np.einsum("mij,mi->mj", jacobian(q, arm), wrench)


def link_weight_loads(T: RigidTransform, q: Floats, arm: Arm, gravity: Floats) -> Floats:
    """Loads (m, n, 4 n) N m of the links' own weight on the joints.

    Per kg and kg m of each link.
    gravity : (3,), or (m, 3) of each posture, m/s^2 in the frame of poses
    Source: Luh, Walker and Paul's recursion at rest, as a regressor: Gautier and Khalil 1990
    """
    chain, n = link_frames(q, arm), len(arm.joints)
    z, o, R = chain[:, :n, :3, 2], chain[:, : n + 1, :3, 3], chain[:, 1 : n + 1, :3, :3]
    out = np.zeros((len(chain), n, n, 4))
    down = np.broadcast_to(gravity, (len(chain), 3))
    tipped = np.cross(np.swapaxes(R, 2, 3), down[:, None, None])  # (m, link, axis of its frame, 3)
    for j in range(n):
        if arm.slides[j]:
            out[:, j, j:, 0] = -(z[:, j] * down).sum(axis=1)[:, None]
            continue
        out[:, j, j:, 0] = -np.einsum("mki,mi->mk", np.cross(o[:, j + 1 :] - o[:, [j]], down[:, None]), z[:, j])
        out[:, j, j:, 1:] = -np.einsum("mkai,mi->mka", tipped[:, j:], z[:, j])
    return out.reshape(len(chain), n, 4 * n)


def link_weight_base_moments(q: Floats, arm: Arm, gravity: Floats) -> Floats:
    """Moments (m, 3, 4 n) N m of the links' own weight about the base's origin.

    Per kg and kg m of each link.
    gravity : (m, 3) m/s^2 of each posture; both in the frame of poses
    """
    chain, n = link_frames(q, arm), len(arm.joints)
    out = np.empty((len(chain), n, 4, 3))
    out[:, :, 0] = np.cross(chain[:, 1 : n + 1, :3, 3] - chain[:, :1, :3, 3], gravity[:, None])
    out[:, :, 1:] = np.cross(np.swapaxes(chain[:, 1 : n + 1, :3, :3], 2, 3), gravity[:, None, None])
    return np.moveaxis(out.reshape(len(chain), 4 * n, 3), 2, 1)


def axis_deviation_and_sway_by_member_growth(
    T: RigidTransform, q: Floats, arm: Arm, share: Floats
) -> tuple[Floats, Floats]:
    """Deviation (m, n) and sway (m, 6) by the growth of links, lengths d and a by shares (m, n).
    A slide's scale is its travel with it.
    """
    chain, rows = link_frames(q, arm), arm.rows
    before, turn = chain[:, : len(rows), :3], (joint_values_with_zero_for_slides(q, arm) + rows[:, 0])[..., None]
    along = np.cos(turn) * before[..., 0] + np.sin(turn) * before[..., 1]  # the common normal
    offset = rows[:, 1] + np.where(arm.slides, q, 0.0)
    moved = np.einsum("mn,mni->mi", share, offset[..., None] * before[..., 2] + rows[:, 2, None] * along)
    return np.zeros(share.shape), np.pad((moved[:, None] @ chain[:, -1, :3, :3])[:, 0], ((0, 0), (0, 3)))


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
    """Points (..., n + 2, 3) m of the line along the links at joint values q (..., n).

    In the frame of poses.
    """
    return link_frames(q, arm)[..., :3, 3]


def strut_ends(T: RigidTransform, arm: Arm) -> None:
    """Strut ends: None, since an arm has no struts."""
    return None


def inverse(T_base_platform: RigidTransform, arm: Arm, guess: Floats | None = None) -> Floats:
    """Inverse kinematics.

    Joint values (..., n) rad or m of a pose, within limits if possible, near the guess.
    T_base_platform : RigidTransform (...); guess : (n,) or (..., n) rad or m, the middle of the limits by default
    Raises Unreachable with the index of poses to which no start leads, and how near (m, rad) the arm comes
    """
    q, left = solve_inverse(T_base_platform, arm, guess)
    failed = np.flatnonzero(np.ravel(left) > GOOD)
    if len(failed):
        lines = [f"pose {i}: the arm comes no nearer than {np.ravel(left)[i] * 1e3:.3g} mm or mrad" for i in failed]
        raise Unreachable(f"{len(failed)} of {left.size} poses are out of the arm's reach:", failed, lines)
    return q


def solve_inverse(
    T_base_platform: RigidTransform, arm: Arm, guess: Floats | None = None, starts: int = STARTS, seed: int = 0
) -> tuple[Floats, Floats]:
    """Inverse kinematics solved by damped least squares from a guess, then random starts.

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
        trying = rng.uniform(arm.limits[:, 0], arm.limits[:, 1], best.shape)
    return best.reshape(*shape, n), left.reshape(shape)


def nearest_equivalent_angles(q: Floats, arm: Arm, reference: Floats) -> Floats:
    """Equivalent angles (..., n), by whole turns within the limits, nearest to a reference.

    Slides unchanged.
    """
    low, high = arm.limits.T
    if arm.slides.any():
        out, turning = np.array(q, float), ~arm.slides
        only = replace(
            arm, joints=arm.joints[turning], limits=arm.limits[turning], slides=np.zeros(int(turning.sum()), bool)
        )
        out[..., turning] = nearest_equivalent_angles(
            out[..., turning], only, np.broadcast_to(reference, out.shape)[..., turning]
        )
        return out
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
        chain = link_frames(q[going], arm)
        e = _twist(chain[:, -1], target[going])
        error[going] = np.maximum(np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1))
        rest = error[going] > TOLERANCE
        if not rest.any():
            break
        going, chain, e = going[rest], chain[rest], e[rest]
        J = geometric_jacobian(chain, slides=arm.slides)
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
