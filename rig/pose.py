"""The few things SciPy's RigidTransform lacks: a tangent with translation first, and covariances on the right.

Frames: T_a_b maps b's coordinates to a. Tangent xi = (x, y, z, rx, ry, rz) in m and rad stands on the right:
T = T_mean * exp(xi), so it lives in b's frame.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

TRIANGLE = np.triu_indices(6)


def pose(position: ArrayLike, rotvec: ArrayLike) -> RigidTransform:
    """RigidTransform (...) from position (..., 3) m and rotation vector (..., 3) rad."""
    return RigidTransform.from_components(np.asarray(position, float), Rotation.from_rotvec(rotvec))


def vector(T: RigidTransform) -> np.ndarray:
    """(..., 6) position (m) and rotation vector (rad) of a RigidTransform (...), as files write it."""
    return np.concatenate([T.translation, T.rotation.as_rotvec()], axis=-1)


def exp(xi: ArrayLike) -> RigidTransform:
    """RigidTransform (...) of the tangent (..., 6), translation first (m, rad)."""
    xi = np.asarray(xi, float)
    return RigidTransform.from_exp_coords(np.concatenate([xi[..., 3:], xi[..., :3]], axis=-1))


def log(T: RigidTransform) -> np.ndarray:
    """Tangent (..., 6) of a RigidTransform (...), translation first (m, rad)."""
    coords = T.as_exp_coords()
    return np.concatenate([coords[..., 3:], coords[..., :3]], axis=-1)


def difference(T_from: RigidTransform, T_to: RigidTransform) -> np.ndarray:
    """(..., 6) position (m) and rotation vector (rad) of T_from^-1 T_to: how far apart two poses are, seen in the first.

    The parts are taken separately (no coupling of rotation into position), the definition used for every pose error.
    """
    return vector(T_from.inv() * T_to)


def transform_points(T: RigidTransform, points: np.ndarray) -> np.ndarray:
    """Points (..., n, 3) of frame b, in frame a, for T_a_b : RigidTransform (...). Same unit as given."""
    matrix = T.as_matrix()
    return points @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]


def skew(vectors: ArrayLike) -> np.ndarray:
    """(..., 3, 3) cross-product matrices of vectors (..., 3)."""
    v = np.asarray(vectors, float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def covariance_from_triangle(triangle: ArrayLike) -> np.ndarray:
    """(..., 6, 6) symmetric from the 21 upper-triangle entries c00 c01 .. c55 (..., 21)."""
    triangle = np.asarray(triangle, float)
    out = np.zeros((*triangle.shape[:-1], 6, 6))
    out[..., TRIANGLE[0], TRIANGLE[1]] = triangle
    out[..., TRIANGLE[1], TRIANGLE[0]] = triangle
    return out
