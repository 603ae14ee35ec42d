"""Refinement of a pose on all corners of a body: compiled robust Gauss-Newton."""

import numpy as np

from rig.array_types import Booleans, Floats, Integers
from rig.compute.numba_kernels_and_lazy_exports import njit
from rig.model.pose import rotate_increment

GATE = 5.0  # standard deviations; beyond, a corner is an outlier
ITERATIONS = 25
SOFT = 10  # iterations, after which outliers are cut off at the latest
CALM = 1e-5  # m or rad; a step so short ends the soft weights
MEDIAN = 1.386  # of chi-square with 2 degrees of freedom
AHEAD = 1e-6  # m; what is nearer to the camera's plane is behind it


@njit(cache=True, nogil=True, error_model="numpy")
def refine_pose(
    corners: tuple[Floats, Floats, Floats, Integers],
    to_camera: Floats,
    focal: Floats,
    matrix: Floats,
    inliers: Booleans,
    least_scale: float,
    J: Floats,
    square: Floats,
) -> float:
    """Refine a pose in place; returns the whitened robust scale at the optimum, or NaN without one.

    corners : (points (n, 3) m in the body, ideal (n, 2), their covariance (n, 2, 2), camera (n,)); to_camera : (c, 4,
        4) T_camera_world
    focal : (c,) px; least : px, the scale's floor; J : (n, 2, 6) filled with the whitened derivatives, square : (n,)
        with the squares
    Raises LinAlgError for a step that nothing determines. Geman-McClure weights at first, then a plain fit of the
        inliers.
    """
    points, ideal, covariance, camera = corners
    n = len(points)
    root, r, seen = np.zeros((n, 3)), np.zeros((n, 2)), np.isfinite(ideal[:, 0])
    finest = _roots(covariance, focal, camera, seen, root, least_scale)
    inliers &= seen
    hard, calm, scale = False, False, np.nan
    for iteration in range(ITERATIONS):
        if inliers.sum() < 4 or not _linearise(corners, to_camera, matrix, root, r, J):
            return np.nan
        for i in range(n):
            square[i] = r[i, 0] ** 2 + r[i, 1] ** 2 if seen[i] else np.inf
        scale = max(np.sqrt(np.median(square[inliers]) / MEDIAN), finest)
        gate = square < (GATE * scale) ** 2
        if hard and calm and (gate == inliers).all():
            break
        hard = hard or calm or iteration > SOFT
        H, g = np.zeros((6, 6)), np.zeros(6)
        for i in range(n):
            inliers[i] = gate[i] or (inliers[i] and not hard)
            w = (1.0 if inliers[i] else 0.0) if hard else 1 / (1 + square[i] / (3 * scale) ** 2) ** 2
            if w > 0.0:
                for row in range(2):
                    for a in range(6):
                        g[a] += w * J[i, row, a] * r[i, row]
                        for b in range(6):
                            H[a, b] += w * J[i, row, a] * J[i, row, b]
        step = np.linalg.solve(H, g)
        for i in range(3):
            for k in range(3):
                matrix[i, 3] += matrix[i, k] * step[k]
        rotate_increment(matrix[:3, :3], step[3:])
        calm = np.abs(step).max() < CALM
    return scale


@njit(cache=True, nogil=True, error_model="numpy")
def _roots(covariance: Floats, focal: Floats, camera: Integers, seen: Booleans, root: Floats, least: float) -> float:
    """Into root (n, 3) the lower triangle (11, 21, 22) of each covariance's inverse square root. Returns least px in
    units of the typical corner.
    """
    typical = np.zeros(len(camera))
    for i in range(len(camera)):
        a, b, c = (covariance[i, 0, 0], covariance[i, 1, 0], covariance[i, 1, 1]) if seen[i] else (1.0, 0.0, 1.0)
        l11 = np.sqrt(a)
        l21 = b / l11
        l22 = np.sqrt(c - l21 * l21)
        root[i, 0], root[i, 1], root[i, 2] = 1 / l11, -l21 / (l11 * l22), 1 / l22
        typical[i] = focal[camera[i]] * np.sqrt((a + c) / 2)
    return least / np.median(typical[seen])


@njit(cache=True, nogil=True, error_model="numpy")
def _linearise(
    corners: tuple[Floats, Floats, Floats, Integers],
    to_camera: Floats,
    matrix: Floats,
    root: Floats,
    r: Floats,
    J: Floats,
) -> bool:
    """Whitened residuals into r (n, 2) and derivatives into J (n, 2, 6) at a pose; returns whether all corners are
    ahead of their cameras.
    """
    points, ideal, _, camera = corners
    both = np.zeros((len(to_camera), 3, 4))
    for c in range(len(to_camera)):
        for row in range(3):
            for column in range(4):
                for k in range(4):
                    both[c, row, column] += to_camera[c, row, k] * matrix[k, column]
    for i in range(len(points)):
        M, x, y, z = both[camera[i]], points[i, 0], points[i, 1], points[i, 2]
        u = M[0, 0] * x + M[0, 1] * y + M[0, 2] * z + M[0, 3]
        v = M[1, 0] * x + M[1, 1] * y + M[1, 2] * z + M[1, 3]
        w = M[2, 0] * x + M[2, 1] * y + M[2, 2] * z + M[2, 3]
        if not w > AHEAD:
            return False
        u, v = u / w, v / w
        du, dv = ideal[i, 0] - u, ideal[i, 1] - v
        du, dv = du if np.isfinite(du) else 0.0, dv if np.isfinite(dv) else 0.0
        r[i, 0], r[i, 1] = root[i, 0] * du, root[i, 1] * du + root[i, 2] * dv
        for k in range(3):
            a, b = (M[0, k] - u * M[2, k]) / w, (M[1, k] - v * M[2, k]) / w
            J[i, 0, k], J[i, 1, k] = root[i, 0] * a, root[i, 1] * a + root[i, 2] * b
        for row in range(2):
            a, b, c = J[i, row, 0], J[i, row, 1], J[i, row, 2]
            J[i, row, 3], J[i, row, 4], J[i, row, 5] = c * y - b * z, a * z - c * x, b * x - a * y
    return True
