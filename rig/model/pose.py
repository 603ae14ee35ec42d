"""Poses (SciPy's RigidTransform) and their tangents.

Tangents, translation first, covariances, vectors; rotation increments.

Frames: T_a_b maps b's coordinates to a. Tangent xi = (x, y, z, rx, ry, rz) in m and rad stands on the right:
T = T_mean * exp(xi), so it lives in b's frame.
"""

import copyreg
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.errors import NotEnoughData

TRIANGLE = np.triu_indices(6)
LOCKED = 1e-9  # cosine of a pitch below which roll and yaw turn about the same axis


def _as_it_is(matrix: Floats) -> RigidTransform:
    """RigidTransform (...) of matrices (..., 4, 4) that are rigid to the last bit that they have: nothing is made
    orthogonal once more.
    """
    return RigidTransform(matrix, normalize=False)


# by itself it would be made orthogonal again wherever it comes to, and what is computed from it there would be other
# bytes
copyreg.pickle(RigidTransform, lambda T: (_as_it_is, (T.as_matrix(),)))


def pose(position: ArrayLike, rotvec: ArrayLike) -> RigidTransform:
    """RigidTransform (...) from position (..., 3) m and rotation vector (..., 3) rad."""
    return RigidTransform.from_components(np.asarray(position, float), Rotation.from_rotvec(rotvec))


def pose_to_vector(T: RigidTransform) -> Floats:
    """Pose as a vector (..., 6).

    Position (m) and rotation vector (rad), as files have it.
    """
    return np.concatenate([T.translation, T.rotation.as_rotvec()], axis=-1)


def exp(xi: ArrayLike) -> RigidTransform:
    """Exponential of a tangent (..., 6), translation first (m, rad).

    It is a RigidTransform (...).
    """
    xi = np.asarray(xi, float)
    return RigidTransform.from_exp_coords(np.concatenate([xi[..., 3:], xi[..., :3]], axis=-1))


def log(T: RigidTransform) -> Floats:
    """Logarithm of a RigidTransform (...).

    Its tangent (..., 6), translation first (m, rad).
    """
    coords = T.as_exp_coords()
    return np.concatenate([coords[..., 3:], coords[..., :3]], axis=-1)


def pose_file_entry(T: RigidTransform) -> dict[str, list[float]]:
    """Pose as an entry of a file, {position, rotvec}.

    In m and rad.
    """
    position, rotvec = np.split(pose_to_vector(T), 2)
    return {"position": position.tolist(), "rotvec": rotvec.tolist()}


def pose_difference(T_from: RigidTransform, T_to: RigidTransform) -> Floats:
    """Pose difference (..., 6): position (m) and rotation vector (rad) of T_from^-1 T_to.

    The parts are taken separately (no coupling of rotation into position), the definition used for every pose error.
    """
    return pose_to_vector(T_from.inv() * T_to)


def poses_pointing_along(directions: Floats) -> RigidTransform:
    """Poses (n,) at the origin whose z axes are unit vectors (n, 3).

    Turned about z in no special way.
    """
    d = np.asarray(directions, float)
    across = np.cross(d, np.eye(3)[np.argmin(np.abs(d), axis=1)])
    x = across / np.linalg.norm(across, axis=1, keepdims=True)
    R = np.stack([x, np.cross(d, x), d], axis=2)
    return RigidTransform.from_components(np.zeros_like(d), Rotation.from_matrix(R))


def direction_difference(T_from: RigidTransform, T_to: RigidTransform) -> Floats:
    """Difference of directions, a small turn (n, 2) rad.

    About x and y of the poses T_from (n,). It takes their z axes to those of T_to (n,).

    On the tangent plane of the unit sphere, so that no direction is special: near the zenith an azimuth counts by the
    cosine of the elevation.
    """
    z = T_to.rotation.as_matrix()[..., 2]
    v = np.einsum("...ji,...j->...i", T_from.rotation.as_matrix(), z)
    across = np.hypot(v[..., 0], v[..., 1])
    factor = np.arctan2(across, v[..., 2]) / np.where(across > 0, across, 1.0)
    return np.stack([-v[..., 1] * factor, v[..., 0] * factor], axis=-1)


def adjoint(T: RigidTransform) -> Floats:
    """Adjoint (..., 6, 6) of poses.

    It satisfies T exp(xi) T^-1 = exp(adjoint(T) xi).
    T : RigidTransform (...,)
    Source: Barfoot, State Estimation for Robotics, 1st ed., eq. 7.37 (there translation first as well)
    """
    R, out = T.rotation.as_matrix(), np.zeros((*np.shape(T.translation)[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(T.translation) @ R
    return out


ALIGNMENT = np.repeat([1e-3, 2e-3], 3)  # m, rad; by which poses weigh that a stated machine and a measurement have
ALIGNMENT_STEPS, HUBER = 50, 3.0
FEWEST_ALIGNED = 4  # poses
LINE = 1e-6  # of the length of a row of positions, within which they lie on a line


def align_poses(
    predicted: RigidTransform, measured: RigidTransform, unknown_ends: tuple[bool, bool], rows_per_pose: int = 6
) -> tuple[RigidTransform, RigidTransform]:
    """Align predicted poses (n,) with measured ones by motions (base, tool).

    With these base * predicted * tool is nearest to measured: robust least squares, from rotations between poses on.

    unknown_ends : whether each is unknown, the identity where not; rows_per_pose : 6, or 3 of positions alone
    Raises NotEnoughData for fewer than FEWEST_ALIGNED poses, and positions on a line
    Source: Park and Martin, Robot sensor calibration: solving AX = XB on the Euclidean group, IEEE Trans. Robotics 1994
    """
    none = RigidTransform.identity()
    base, tool = none, none
    p, q = predicted.translation, measured.translation
    if len(p) < FEWEST_ALIGNED:
        raise NotEnoughData(
            f"where an instrument stands is determined from {FEWEST_ALIGNED} poses at least, not {len(p)}"
        )
    if unknown_ends[0] and rows_per_pose == 3:
        spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
        if spread[1] <= LINE * spread[0]:
            raise NotEnoughData(f"{len(p)} positions on a line do not determine how an instrument is turned about it")
    if unknown_ends[0] and rows_per_pose == 6:
        turned = [(T.rotation * T.rotation[0].inv()).as_rotvec()[1:] for T in (measured, predicted)]
        start = (measured.rotation * predicted.rotation.inv()).mean()
        turn = Rotation.align_vectors(*turned)[0] if unknown_ends[1] else start
        base = RigidTransform.from_rotation(turn)
    elif unknown_ends[0]:
        base = RigidTransform.from_rotation(Rotation.align_vectors(q - q.mean(axis=0), p - p.mean(axis=0))[0])
    if unknown_ends[1] and rows_per_pose == 6:
        tool = RigidTransform.from_rotation((predicted.rotation.inv() * base.rotation.inv() * measured.rotation).mean())
    free = np.repeat([unknown_ends[0], unknown_ends[0], unknown_ends[1], unknown_ends[1] and rows_per_pose == 6], 3)
    for _ in range(ALIGNMENT_STEPS):
        moved = predicted * tool
        left = (pose_difference(base * moved, measured) / ALIGNMENT)[:, :rows_per_pose]
        size = np.sqrt((left**2).mean(axis=1))
        weight = np.minimum(1.0, HUBER * max(float(np.median(size)), 1e-9) / np.maximum(size, 1e-12))
        columns = np.concatenate([adjoint(moved.inv()), np.broadcast_to(np.eye(6), (len(p), 6, 6))], axis=2) * free
        columns = (columns / ALIGNMENT[:, None])[:, :rows_per_pose]
        H = np.einsum("n,nia,nib->ab", weight, columns, columns) + np.eye(12)
        step = np.linalg.solve(H, np.einsum("n,nia,ni->a", weight, columns, left)) * free
        base, tool = base * exp(step[:6]), tool * exp(step[6:])
        if np.abs(step).max() < 1e-9:
            break
    return base, tool


def roll_pitch_yaw(T: RigidTransform) -> Floats:
    """Roll, pitch and yaw (..., 3) rad of a RigidTransform (...), about fixed x, y and z in this order.

    R = Rz(yaw) Ry(pitch) Rx(roll). At a pitch of a quarter turn roll and yaw turn alike; all of it is told as roll, yaw
    is 0
    """
    R = T.rotation.as_matrix()
    pitch = np.arctan2(-R[..., 2, 0], np.hypot(R[..., 0, 0], R[..., 1, 0]))
    locked = np.hypot(R[..., 0, 0], R[..., 1, 0]) < LOCKED
    roll = np.where(locked, np.arctan2(-R[..., 1, 2], R[..., 1, 1]), np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    return np.stack([roll, pitch, np.where(locked, 0.0, np.arctan2(R[..., 1, 0], R[..., 0, 0]))], axis=-1)


def roll_pitch_yaw_sigmas(T: RigidTransform, covariance: Floats) -> Floats:
    """Standard deviations (..., 3) rad of roll, pitch and yaw.

    Of poses with a covariance.
    """
    roll, pitch, _ = np.moveaxis(roll_pitch_yaw(T), -1, 0)
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    cp = np.where(np.abs(cp) < LOCKED, np.nan, cp)
    zero, one = np.zeros(np.shape(roll)), np.ones(np.shape(roll))
    rates = np.stack(
        [
            np.stack([one, sr * sp / cp, cr * sp / cp], -1),
            np.stack([zero, cr, -sr], -1),
            np.stack([zero, sr / cp, cr / cp], -1),
        ],
        -2,
    )
    spread = np.einsum("...ij,...jk,...ik->...i", rates, np.asarray(covariance)[..., 3:, 3:], rates)
    return np.sqrt(np.where(np.isnan(spread), np.inf, spread))


def transform_points(T: RigidTransform, points: Floats) -> Floats:
    """Points (..., n, 3) transformed from frame b to frame a by T_a_b : RigidTransform (...)."""
    matrix = T.as_matrix()
    return points @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]


def skew(vectors: ArrayLike) -> Floats:
    """Skew-symmetric cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    v = np.asarray(vectors, float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def covariance_from_triangle(triangle: ArrayLike) -> Floats:
    """Covariance (..., 6, 6) from its upper triangle c00 c01 .. c55 (..., 21)."""
    triangle = np.asarray(triangle, float)
    out = np.zeros((*triangle.shape[:-1], 6, 6))
    out[..., TRIANGLE[0], TRIANGLE[1]] = triangle
    out[..., TRIANGLE[1], TRIANGLE[0]] = triangle
    return out


def rms_uncertainty(covariance: Floats) -> tuple[float, float]:
    """RMS standard uncertainty (m, rad) of position and rotation of covariances (n, 6, 6).

    Of the length of each, of what was measured; else infinite.
    """
    variances = np.einsum("nii->ni", covariance)
    known = np.where(np.isinf(variances), 0.0, variances)
    position, rotation = (
        float(np.sqrt(known[:, part].sum(axis=1).mean())) if np.isfinite(variances[:, part]).any() else np.inf
        for part in (slice(0, 3), slice(3, 6))
    )
    return position, rotation


def displace_selected_poses(
    poses: RigidTransform, selected: Booleans, motion: Callable[[RigidTransform], RigidTransform]
) -> RigidTransform:
    """Poses (m,) of which the selected ones, selected (m,) bool, are displaced by motion(T)."""
    if not selected.any():
        return poses
    matrices = poses.as_matrix().copy()
    at = np.flatnonzero(selected)
    matrices[at] = motion(poses[at]).as_matrix()
    return RigidTransform.from_matrix(matrices)


@njit(cache=True, nogil=True)
def rotate_in_place(R: Floats, w: NDArray[np.floating]) -> None:
    """Rotate R (3, 3) in place by the increment w (3,), a rotation vector.

    R becomes R exp(w).
    """
    x, y, z = w[0], w[1], w[2]
    angle = np.sqrt(x * x + y * y + z * z)
    if angle < 1e-4:
        s, c = 1.0 - angle**2 / 6, 0.5 - angle**2 / 24
    else:
        s, c = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2
    for i in range(3):
        r0, r1, r2 = R[i, 0], R[i, 1], R[i, 2]
        R[i, 0] = r0 * (1 - c * (y * y + z * z)) + r1 * (s * z + c * x * y) + r2 * (c * x * z - s * y)
        R[i, 1] = r0 * (c * x * y - s * z) + r1 * (1 - c * (x * x + z * z)) + r2 * (s * x + c * y * z)
        R[i, 2] = r0 * (s * y + c * x * z) + r1 * (c * y * z - s * x) + r2 * (1 - c * (x * x + y * y))
