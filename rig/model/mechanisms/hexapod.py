"""Hexapod (Gough-Stewart platform): forward and inverse kinematics, Jacobian, limits and loads.

Also singular geometries, and the twist of its cardans.
"""

from __future__ import annotations

from functools import lru_cache
from typing import cast

import numpy as np
from scipy.linalg import lu
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod_kernels
from rig.model.mechanisms.hexapod_newton_and_least_squares_forward_solution import (
    MAX_TURN,
    TOLERANCE,
    poses_of_redundant_lengths_by_gauss_newton,
    require_converged_forward_solution,
    solve_poses_in_place_by_pivoted_newton,
    strut_lengths_and_jacobian,
)
from rig.model.pose import exp, transform_points

AXIS, UNIT = "strut", "m"
CHUNK = 4096  # poses at a time, so that the work stays in the cache


def inverse(T_base_platform: RigidTransform, hexapod: Hexapod) -> Floats:
    """Inverse kinematics: commanded strut lengths of a pose, joint centre to joint centre less strut zeros.

    T_base_platform : RigidTransform (...); hexapod : Hexapod
    Returns (..., struts) m; whether they are within the strut range is for `limits` to say
    Source: Merlet, Parallel Robots, 2nd ed., ch. 3
    """
    matrix = np.ascontiguousarray(T_base_platform.as_matrix())
    flat, out = matrix.reshape(-1, 4, 4), np.empty((matrix.size // 16, len(hexapod.axes)))
    hexapod_kernels.run_kernel_in_threads(
        lambda part: hexapod_kernels.fill_strut_lengths_of_poses(
            flat[part], hexapod.base_joints, hexapod.platform_joints, hexapod.strut_zeros, out[part]
        ),
        len(flat),
    )
    return out.reshape(*matrix.shape[:-2], -1)


def jacobian(T_base_platform: RigidTransform, hexapod: Hexapod) -> Floats:
    """Jacobian of the strut lengths with the pose's tangent on the right.

    T_base_platform : RigidTransform (...)
    Returns (..., struts, 6), rows struts, columns x y z (m/m) and rx ry rz (m/rad) in the platform frame
    Source: Merlet, Parallel Robots, 2nd ed., ch. 5
    """
    matrix = T_base_platform.as_matrix()
    return strut_lengths_and_jacobian(matrix[..., :3, :3], matrix[..., :3, 3], hexapod)[1]


def forward(lengths: Floats, hexapod: Hexapod, guess: RigidTransform | None = None) -> RigidTransform:
    """Forward kinematics: the platform pose of commanded strut lengths, by Newton on SE(3) in batches.

    More than six lengths close on no pose
    unless they agree: then it is the pose with the least sum of squares of what each strut is off by, which is where
    struts of one stiffness hold the platform in static equilibrium, docs/mathematics.md (7).
    lengths : (..., struts) m, as commanded (the strut zeros are added here)
    guess : RigidTransform () or (...), the home pose by default; decides which assembly is meant
    Returns T_base_platform : RigidTransform (...)
    Raises NotConverged with index, lengths and residual (m) of those poses that have no solution near the guess, or
    whose solution lies beyond a singularity, in another assembly; ValueError for a wrong shape or lengths that are not
    finite
    Source: Merlet, Parallel Robots, 2nd ed., ch. 4
    """
    lengths = np.asarray(lengths, float)
    count = len(hexapod.axes)
    if lengths.shape[-1:] != (count,) or not np.isfinite(lengths).all():
        raise ValueError(f"expected finite lengths (..., {count}) m, got shape {lengths.shape}")
    guess = hexapod.home if guess is None else guess
    flat = lengths.reshape(-1, count) + hexapod.strut_zeros
    if count > 6:
        return RigidTransform.from_matrix(
            poses_of_redundant_lengths_by_gauss_newton(lengths, flat, guess, hexapod).reshape(*lengths.shape[:-1], 4, 4)
        )
    matrix, residual, crossed = np.empty((len(flat), 4, 4)), np.empty(len(flat)), np.empty(len(flat), bool)
    start = guess.as_matrix()
    if start.ndim > 2:
        start = np.broadcast_to(start, (*lengths.shape[:-1], 4, 4)).reshape(-1, 4, 4)
    _side_by_side(flat, start.reshape(-1, 4, 4), hexapod, (matrix, residual, crossed))
    failed = np.flatnonzero(~(residual <= TOLERANCE) | crossed)
    if len(failed):  # with pivots, and a word on what has no solution
        began = start if start.ndim > 2 else np.broadcast_to(start, (len(flat), 4, 4))
        for at in range(0, len(failed), CHUNK):
            part = failed[at : at + CHUNK]
            moved = began[part].copy()
            residual[part] = solve_poses_in_place_by_pivoted_newton(moved, flat[part], hexapod)
            matrix[part] = moved
        require_converged_forward_solution(matrix, began, residual, lengths, hexapod, failed)
    return RigidTransform(
        matrix.reshape(*lengths.shape[:-1], 4, 4), normalize=False, copy=False
    )  # of unit quaternions, normal as it is


def signed_limit_excess(lengths: Floats, hexapod: Hexapod) -> Floats:
    """Excess of commanded lengths over their limits, (..., struts) m.

    Negative below, positive above, 0 inside.
    """
    low, high = hexapod.strut_range.T
    return np.minimum(lengths - low, 0) + np.maximum(lengths - high, 0)


def travel_ranges(hexapod: Hexapod) -> Floats:
    """Travel (struts, 2) m of the struts.

    Shortest and longest commanded length.
    """
    return hexapod.strut_range


def home_values(hexapod: Hexapod) -> Floats:
    """Home lengths (struts,) m.

    Commanded lengths at the home pose.
    """
    return inverse(hexapod.home, hexapod)


def axis_forces_and_torques(T: RigidTransform, lengths: Floats, hexapod: Hexapod, wrench: Floats) -> Floats:
    """Axis forces (n, struts) N of the struts that hold a wrench.

    Pushing, with a wrench (n, 6) on the platform: J^T f + w = 0. Of more than six struts the least squares of all
    loads, as struts of one stiffness share them, beyond what they bear against each other; followers bear none.
    Source: Merlet, Parallel Robots, 2nd ed., ch. 9
    """
    if len(hexapod.axes) > 6:
        driven, out = np.delete(np.arange(len(hexapod.axes)), hexapod.followers), np.zeros(np.shape(lengths))
        out[:, driven] = -np.einsum("nij,ni->nj", np.linalg.pinv(jacobian(T, hexapod)[:, driven]), wrench)
        return out
    return cast(Floats, np.linalg.solve(np.swapaxes(jacobian(T, hexapod), 1, 2), -wrench[..., None])[..., 0])


def link_weight_loads(T: RigidTransform, lengths: Floats, hexapod: Hexapod, gravity: Floats) -> Floats:
    """Loads of link weight (n, struts, 0), which a hexapod has none of.

    It has no arm links whose weight its struts bear.
    """
    return np.zeros((*np.shape(lengths), 0))


def axis_deviation_and_sway_by_member_growth(
    T: RigidTransform, lengths: Floats, hexapod: Hexapod, share: Floats
) -> tuple[Floats, Floats]:
    """Axis deviation (n, struts) m and sway (n, 6) by growth of members, which are struts.

    They grow by shares (n, struts) of their length.

    No sway.
    """
    return share * lengths, np.zeros((len(share), 6))


def inverse_kinematics_jacobian(T: RigidTransform, lengths: Floats, hexapod: Hexapod) -> Floats:
    """Jacobian (n, struts, 6) of inverse kinematics.

    Change of strut lengths with the pose's tangent, at poses T (n,).
    """
    return jacobian(T, hexapod)


def jacobian_rows_by_axis(T: RigidTransform, lengths: Floats, hexapod: Hexapod) -> Floats:
    """Rows (n, struts, 6) of the Jacobian, one for each strut, at poses T (n,).

    They coincide where the machine is singular.
    """
    return jacobian(T, hexapod)


def link_points(lengths: Floats, hexapod: Hexapod) -> None:
    """None for any lengths (n, struts) m: a hexapod has no arm links to draw."""
    return None


def strut_ends(T: RigidTransform, hexapod: Hexapod) -> tuple[Floats, Floats]:
    """Ends of the struts.

    Base joints (struts, 3) and platform joints (n, struts, 3) m, base frame, at poses T (n,).
    """
    return hexapod.base_joints, transform_points(T, hexapod.platform_joints)


def _side_by_side(lengths: Floats, start: Floats, hexapod: Hexapod, out: tuple[Floats, Floats, Floats]) -> None:
    """Fill out, the matrix (n, 4, 4), residual (n,) m and crossed (n,) of lengths (n, 6) m, from start (n or 1, 4,
    4).
    """
    q = Rotation.from_matrix(start[:, :3, :3]).as_quat(scalar_first=True)
    t = np.ascontiguousarray(start[:, :3, 3])
    struts = hexapod_kernels.StrutGeometry(
        hexapod.base_joints,
        hexapod.platform_joints,
        _order(hexapod),
        0.3 * float(np.linalg.norm(hexapod.home.translation)),
        MAX_TURN,
    )

    def solve(part: slice) -> None:
        begin = (q, t) if len(q) == 1 else (q[part], t[part])
        hexapod_kernels.fill_poses_of_strut_lengths_by_newton(
            lengths[part], struts, begin, TOLERANCE, *(one[part] for one in out)
        )

    hexapod_kernels.run_kernel_in_threads(solve, len(lengths))


@lru_cache(64)
def _order(hexapod: Hexapod) -> Floats:
    """(6,) struts in the order in which elimination with pivots takes the Jacobian's rows at home."""
    return np.argmax(lu(jacobian(hexapod.home, hexapod))[0], axis=0)


SINGULAR = 1e-6  # of the largest singular value of the Jacobian, rotations weighed by the platform's size
MOVES = np.array(
    [[0.1, 0, 0, 0, 0, 0], [0, 0.1, 0, 0.1, 0, 0], [0, 0, 0.1, 0, 0.1, 0], [0, 0, 0, 0, 0, 0.1]]
)  # platform sizes, rad


def singular_geometry_problem(hexapod: Hexapod) -> str | None:
    """Problem of a hexapod that is singular at home or by its architecture, in words.

    None where it is not.

    Joints on similar hexagons, one plate turned against the other or not, leave it loose wherever it stands.
    Sources: Ma and Angeles, Architecture singularities of parallel manipulators, 1992; Merlet, Parallel Robots, 2nd
    ed., ch. 6
    """
    size = max(
        float(np.linalg.norm(hexapod.platform_joints - hexapod.platform_joints.mean(axis=0), axis=1).mean()), 1e-9
    )
    if _least(hexapod, np.zeros(6), size) > SINGULAR:
        return None
    if all(_least(hexapod, move, size) <= SINGULAR for move in MOVES * np.repeat([size, 1.0], 3)):
        return (
            "is singular by its architecture: whatever the strut lengths, the platform is loose at every "
            "pose, since base and platform joints "
            "lie on similar hexagons or the like (Ma and Angeles 1992); set the joints of one plate nearer in pairs"
        )
    return (
        "is singular: there the strut lengths do not hold the platform, and no pose follows from them; another "
        "home is needed, turned or tilted"
    )


def _least(hexapod: Hexapod, move: Floats, size: float) -> float:
    """Least singular value of the Jacobian at home moved by a tangent (m, rad), as a share of the largest; 0 where a
    strut has no length.
    """
    matrix = (hexapod.home * exp(move)).as_matrix()
    R, a = matrix[:3, :3], hexapod.platform_joints
    struts = (a @ R.T + matrix[:3, 3] - hexapod.base_joints) @ R
    lengths = np.linalg.norm(struts, axis=1)
    if lengths.min() <= 0:
        return 0.0
    u = struts / lengths[:, None]
    values = np.linalg.svd(np.hstack([u, np.cross(a, u) / size]), compute_uv=False)
    return float(values[-1] / values[0])


@lru_cache(16)  # effects ask it of the same poses again and again
def cardan_twist_angles_about_struts(T: RigidTransform, mechanism: Hexapod) -> Floats:
    """Twist (..., struts) rad of each cardan about its strut, platform side against base side.

    A cardan's first axis lies in its plate, tangential, (-y, x, 0) of the joint in the plate's frame; its second is
    perpendicular to the first and to the strut. Right-handed about u, from base to platform.
    """
    R = T.rotation.as_matrix()[..., None, :, :]
    u = T.as_matrix()[..., None, :3, 3] + (R @ mechanism.platform_joints[..., None])[..., 0] - mechanism.base_joints
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    base, moved = (
        cardan_plate_axes(mechanism.base_joints),
        (R @ cardan_plate_axes(mechanism.platform_joints)[..., None])[..., 0],
    )
    a, b = np.cross(u, np.broadcast_to(base, u.shape)), np.cross(u, moved)
    twist = np.arctan2(np.einsum("...i,...i->...", np.cross(a, b), u), np.einsum("...i,...i->...", a, b))
    twist.setflags(write=False)
    return np.asarray(twist)


def cardan_plate_axes(joints: Floats) -> Floats:
    """Axes (struts, 3) of cardans that lie in a plate.

    The first axes of those at joints (struts, 3) m of the plate, in its frame.

    Tangential, as long as the joint is off its middle.
    """
    return np.stack([-joints[:, 1], joints[:, 0], np.zeros(len(joints))], axis=1)
