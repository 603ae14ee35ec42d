"""OpenCV's lens: project with Jacobian, undistort. Points in the camera's frame (OpenCV axes: x right, y down, z ahead)."""

from typing import Any

import numpy as np

INTRINSICS = ("fx", "fy", "cx", "cy")
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
UNDISTORT_TOLERANCE = 1e-13  # of the focal length


def project(points: np.ndarray, matrix: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of points (..., 3) m in the camera's frame.

    matrix : (3, 3) px; distortion : (4, 5, 8, 12 or 14,) in OpenCV's order. A point must lie ahead (z > 0).
    Source: OpenCV, calib3d camera model
    """
    return _project(np.asarray(points, float), matrix, distortion, jacobian=False)


def project_jacobian(points: np.ndarray, matrix: np.ndarray, distortion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (..., 2), their Jacobian to the point (..., 2, 3) px/m and to the lens (..., 2, 4 + terms).

    Lens columns: fx fy cx cy (px/px), then the distortion terms in OpenCV's order.
    """
    return _project(np.asarray(points, float), matrix, distortion, jacobian=True)


def undistort(uv: np.ndarray, matrix: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Ideal image coordinates x/z, y/z (..., 2) of pixels (..., 2): Newton on the lens, to 1e-13.

    Pixels to which the lens maps nothing come back as NaN.
    """
    uv = np.asarray(uv, float)
    focal, centre = np.array([matrix[0, 0], matrix[1, 1]]), np.array([matrix[0, 2], matrix[1, 2]])
    goal = (uv - centre) / focal
    ideal = goal.copy()
    unit = np.eye(3)
    for _ in range(30):
        points = np.concatenate([ideal, np.ones_like(ideal[..., :1])], axis=-1)
        distorted, J, _ = project_jacobian(points, unit, distortion)
        error = goal - distorted
        if np.nanmax(np.abs(error), initial=0) < UNDISTORT_TOLERANCE:
            break
        a, b, c, d = J[..., 0, 0], J[..., 0, 1], J[..., 1, 0], J[..., 1, 1]
        det = np.where(np.abs(a * d - b * c) > 1e-9, a * d - b * c, np.nan)
        step = np.stack([d * error[..., 0] - b * error[..., 1], a * error[..., 1] - c * error[..., 0]], axis=-1) / det[..., None]
        ideal = ideal + np.clip(step, -0.3, 0.3)
    lost = ~(np.abs(error).max(axis=-1, keepdims=True) < 1e-9)
    return np.where(lost, np.nan, ideal)


def terms(distortion: np.ndarray) -> tuple[str, ...]:
    """Names of the lens's parameters in the Jacobian's order. distortion : (4, 5, 8, 12 or 14,)"""
    return INTRINSICS + DISTORTION[: len(distortion)]


def _project(points: np.ndarray, matrix: np.ndarray, distortion: np.ndarray, jacobian: bool) -> Any:
    k = np.zeros(14)
    k[: len(distortion)] = distortion
    z = points[..., 2]
    x, y = points[..., 0] / z, points[..., 1] / z
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    numerator = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    denominator = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    radial = numerator / denominator
    xd = x * radial + 2 * k[2] * xy + k[3] * (r2 + 2 * xx) + r2 * (k[8] + r2 * k[9])
    yd = y * radial + k[2] * (r2 + 2 * yy) + 2 * k[3] * xy + r2 * (k[10] + r2 * k[11])
    tilt = _tilt(k[12], k[13]) if k[12] or k[13] else None
    xt, yt = (xd, yd) if tilt is None else _apply_tilt(tilt, xd, yd)
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    uv = np.stack([fx * xt + cx, fy * yt + cy], axis=-1)
    if not jacobian:
        return uv
    n = len(distortion)
    dradial = ((k[0] + r2 * (2 * k[1] + 3 * r2 * k[4])) - radial * (k[5] + r2 * (2 * k[6] + 3 * r2 * k[7]))) / denominator  # to r2
    to_ideal = np.empty((*x.shape, 2, 2))  # (xd, yd) to (x, y)
    thin_x, thin_y = k[8] + 2 * r2 * k[9], k[10] + 2 * r2 * k[11]
    to_ideal[..., 0, 0] = radial + 2 * xx * dradial + 2 * k[2] * y + 6 * k[3] * x + 2 * x * thin_x
    to_ideal[..., 0, 1] = 2 * xy * dradial + 2 * k[2] * x + 2 * k[3] * y + 2 * y * thin_x
    to_ideal[..., 1, 0] = 2 * xy * dradial + 2 * k[2] * x + 2 * k[3] * y + 2 * x * thin_y
    to_ideal[..., 1, 1] = radial + 2 * yy * dradial + 6 * k[2] * y + 2 * k[3] * x + 2 * y * thin_y
    to_terms = np.zeros((*x.shape, 2, 14))
    for i, factor in ((0, r2), (1, r2**2), (4, r2**3)):
        to_terms[..., 0, i], to_terms[..., 1, i] = x * factor / denominator, y * factor / denominator
    for i, factor in ((5, r2), (6, r2**2), (7, r2**3)):
        to_terms[..., 0, i], to_terms[..., 1, i] = -x * radial * factor / denominator, -y * radial * factor / denominator
    to_terms[..., 0, 2], to_terms[..., 1, 2] = 2 * xy, r2 + 2 * yy
    to_terms[..., 0, 3], to_terms[..., 1, 3] = r2 + 2 * xx, 2 * xy
    to_terms[..., 0, 8], to_terms[..., 0, 9], to_terms[..., 1, 10], to_terms[..., 1, 11] = r2, r2**2, r2, r2**2
    if tilt is not None or n == 14:
        to_distorted = _tilt_jacobian(tilt if tilt is not None else np.eye(3), xd, yd)
        to_ideal = to_distorted @ to_ideal
        to_terms = to_distorted @ to_terms
        for i in (12, 13):
            step = np.zeros(2, complex)
            step[i - 12] = 1e-30j  # complex step: exact for this analytic function
            shifted = _apply_tilt(_tilt(k[12] + step[0], k[13] + step[1]), xd, yd)
            to_terms[..., 0, i], to_terms[..., 1, i] = shifted[0].imag / 1e-30, shifted[1].imag / 1e-30
    ideal_to_point = np.zeros((*x.shape, 2, 3))
    ideal_to_point[..., 0, 0] = ideal_to_point[..., 1, 1] = 1 / z
    ideal_to_point[..., 0, 2], ideal_to_point[..., 1, 2] = -x / z, -y / z
    focal = np.array([fx, fy])[:, None]
    J_lens = np.zeros((*x.shape, 2, 4 + n))
    J_lens[..., 0, 0], J_lens[..., 1, 1] = xt, yt
    J_lens[..., 0, 2] = J_lens[..., 1, 3] = 1
    J_lens[..., 4:] = focal * to_terms[..., :n]
    return uv, focal * (to_ideal @ ideal_to_point), J_lens


def _tilt(tau_x: complex, tau_y: complex) -> np.ndarray:
    """(3, 3) map of a tilted sensor. Source: OpenCV computeTiltProjectionMatrix (Scheimpflug)."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    R = np.array([[cy, 0 * cy, -sy], [0 * cy, 1 + 0 * cy, 0 * cy], [sy, 0 * cy, cy]]) @ np.array(
        [[1 + 0 * cx, 0 * cx, 0 * cx], [0 * cx, cx, sx], [0 * cx, -sx, cx]])
    lift = np.array([[R[2, 2], 0 * cx, -R[0, 2]], [0 * cx, R[2, 2], -R[1, 2]], [0 * cx, 0 * cx, 1 + 0 * cx]])
    return lift @ R


def _apply_tilt(tilt: np.ndarray, xd: np.ndarray, yd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    w = tilt[2, 0] * xd + tilt[2, 1] * yd + tilt[2, 2]
    return (tilt[0, 0] * xd + tilt[0, 1] * yd + tilt[0, 2]) / w, (tilt[1, 0] * xd + tilt[1, 1] * yd + tilt[1, 2]) / w


def _tilt_jacobian(tilt: np.ndarray, xd: np.ndarray, yd: np.ndarray) -> np.ndarray:
    xt, yt = _apply_tilt(tilt, xd, yd)
    w = tilt[2, 0] * xd + tilt[2, 1] * yd + tilt[2, 2]
    J = np.empty((*xd.shape, 2, 2))
    for i, value in enumerate((xt, yt)):
        for j in range(2):
            J[..., i, j] = (tilt[i, j] - value * tilt[2, j]) / w
    return J
