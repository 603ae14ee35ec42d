"""Lens model of a camera, OpenCV's: projection with Jacobian, and undistortion.

With their compiled kernels.

Points in the camera's frame (OpenCV axes: x right, y down, z
ahead).
"""

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _project_kernel(points: Floats, matrix: Floats, k: Floats, uv: Floats) -> None:
    """Into uv (n, 2) px the images of points (n, 3) m in the camera's frame; matrix : (3, 3) px; k : (14,) terms as
    OpenCV orders them.
    """
    for n in range(len(points)):
        x, y = points[n, 0] / points[n, 2], points[n, 1] / points[n, 2]
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
        xd = x * radial + 2 * k[2] * xy + k[3] * (r2 + 2 * xx) + r2 * (k[8] + r2 * k[9])
        yd = y * radial + k[2] * (r2 + 2 * yy) + 2 * k[3] * xy + r2 * (k[10] + r2 * k[11])
        uv[n, 0], uv[n, 1] = matrix[0, 0] * xd + matrix[0, 2], matrix[1, 1] * yd + matrix[1, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _project_jacobian_kernel(
    points: Floats, matrix: Floats, k: Floats, uv: Floats, to_point: Floats, to_lens: Floats
) -> None:
    """The same, and into to_point (n, 2, 3) px/m and to_lens (n, 2, 4 + terms) how they change with points, fx fy cx cy
    and terms.
    """
    fx, fy, terms = matrix[0, 0], matrix[1, 1], to_lens.shape[2] - 4
    row = np.zeros((2, 14))
    for n in range(len(points)):
        z = points[n, 2]
        x, y = points[n, 0] / z, points[n, 1] / z
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        denominator = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / denominator
        xd = x * radial + 2 * k[2] * xy + k[3] * (r2 + 2 * xx) + r2 * (k[8] + r2 * k[9])
        yd = y * radial + k[2] * (r2 + 2 * yy) + 2 * k[3] * xy + r2 * (k[10] + r2 * k[11])
        uv[n, 0], uv[n, 1] = fx * xd + matrix[0, 2], fy * yd + matrix[1, 2]
        slope = (
            (k[0] + r2 * (2 * k[1] + 3 * r2 * k[4])) - radial * (k[5] + r2 * (2 * k[6] + 3 * r2 * k[7]))
        ) / denominator  # radial's, to r2
        thin_x, thin_y = k[8] + 2 * r2 * k[9], k[10] + 2 * r2 * k[11]
        cross = 2 * xy * slope + 2 * k[2] * x + 2 * k[3] * y
        a, b = radial + 2 * xx * slope + 2 * k[2] * y + 6 * k[3] * x + 2 * x * thin_x, cross + 2 * y * thin_x
        c, d = cross + 2 * x * thin_y, radial + 2 * yy * slope + 6 * k[2] * y + 2 * k[3] * x + 2 * y * thin_y
        to_point[n, 0, 0], to_point[n, 0, 1], to_point[n, 0, 2] = fx * a / z, fx * b / z, -fx * (a * x + b * y) / z
        to_point[n, 1, 0], to_point[n, 1, 1], to_point[n, 1, 2] = fy * c / z, fy * d / z, -fy * (c * x + d * y) / z
        power = r2 / denominator
        for i, j in ((0, 5), (1, 6), (4, 7)):
            row[0, i], row[1, i] = x * power, y * power
            row[0, j], row[1, j] = -x * radial * power, -y * radial * power
            power *= r2
        row[0, 2], row[1, 2], row[0, 3], row[1, 3] = 2 * xy, r2 + 2 * yy, r2 + 2 * xx, 2 * xy
        row[0, 8], row[0, 9], row[1, 10], row[1, 11] = r2, r2 * r2, r2, r2 * r2
        to_lens[n, 0, 0], to_lens[n, 1, 0], to_lens[n, 0, 1], to_lens[n, 1, 1] = xd, 0.0, 0.0, yd
        to_lens[n, 0, 2], to_lens[n, 1, 2], to_lens[n, 0, 3], to_lens[n, 1, 3] = 1.0, 0.0, 0.0, 1.0
        for i in range(terms):
            to_lens[n, 0, 4 + i], to_lens[n, 1, 4 + i] = fx * row[0, i], fy * row[1, i]


@njit(cache=True, nogil=True, error_model="numpy")
def fill_base_frame_points(
    points: Floats, Ts_base_platform: Floats, frame: Integers, on_platform: Booleans, out: Floats
) -> None:
    """Transform the points on the platform by the pose of their frame, into out (n, 3) m.

    Others are copied.
    points : (n, 3) m; Ts_base_platform : (F, 4, 4); frame : (n,); on_platform : (n,) bool
    """
    for n in range(len(points)):
        for i in range(3):
            out[n, i] = points[n, i]
            if on_platform[n]:
                M = Ts_base_platform[frame[n]]
                out[n, i] = M[i, 0] * points[n, 0] + M[i, 1] * points[n, 1] + M[i, 2] * points[n, 2] + M[i, 3]


INTRINSICS = ("fx", "fy", "cx", "cy")
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
UNDISTORT_TOLERANCE = 1e-13  # of the focal length


def project(points: Floats, matrix: Floats, distortion: Floats) -> Floats:
    """Project points (..., 3) m in the camera's frame to pixels (..., 2).

    matrix : (3, 3) px; distortion : (4, 5, 8, 12 or 14,) in OpenCV's order. A point must lie ahead (z > 0).
    Source: OpenCV, calib3d camera model
    """
    flat, matrix, k = _flat(points, matrix, distortion)
    uv, tilted = np.empty((len(flat), 2)), bool(k[12:].any())
    _project_kernel(flat, np.eye(3) if tilted else matrix, k, uv)
    return (_on_sensor(uv, matrix, _tilt(*k[12:])) if tilted else uv).reshape(*np.shape(points)[:-1], 2)


def projected_pixels_and_jacobians(points: Floats, matrix: Floats, distortion: Floats) -> tuple[Floats, Floats, Floats]:
    """Projected pixels (..., 2), and their Jacobian.

    With the point (..., 2, 3) and the lens (..., 2, 4 + terms).

    Lens columns: fx fy cx cy (px/px), then the distortion terms in OpenCV's order.
    """
    flat, matrix, k = _flat(points, matrix, distortion)
    sensor, shape = len(distortion) == 14, np.shape(points)[:-1]
    uv, to_point, to_lens = (
        np.empty((len(flat), 2)),
        np.empty((len(flat), 2, 3)),
        np.empty((len(flat), 2, 4 + len(distortion))),
    )
    _project_jacobian_kernel(flat, np.eye(3) if sensor else matrix, k, uv, to_point, to_lens)
    if sensor:
        _derivatives_on_sensor(uv, to_point, to_lens, matrix, k[12:])
        uv = _on_sensor(uv, matrix, _tilt(*k[12:]))
    return uv.reshape(*shape, 2), to_point.reshape(*shape, 2, 3), to_lens.reshape(*shape, 2, -1)


def undistort(uv: Floats, matrix: Floats, distortion: Floats) -> Floats:
    """Undistorted ideal coordinates (..., 2) of pixels (..., 2).

    x/z, y/z by Newton on the lens to 1e-13.

    Pixels to which the lens maps nothing come back as NaN.
    """
    uv = np.asarray(uv, float)
    focal, centre = np.array([matrix[0, 0], matrix[1, 1]]), np.array([matrix[0, 2], matrix[1, 2]])
    goal = (uv - centre) / focal
    ideal = goal.copy()
    unit = np.eye(3)
    for _ in range(30):
        points = np.concatenate([ideal, np.ones_like(ideal[..., :1])], axis=-1)
        distorted, J, _ = projected_pixels_and_jacobians(points, unit, distortion)
        error = goal - distorted
        if np.nanmax(np.abs(error), initial=0) < UNDISTORT_TOLERANCE:
            break
        a, b, c, d = J[..., 0, 0], J[..., 0, 1], J[..., 1, 0], J[..., 1, 1]
        det = np.where(np.abs(a * d - b * c) > 1e-9, a * d - b * c, np.nan)
        step = (
            np.stack([d * error[..., 0] - b * error[..., 1], a * error[..., 1] - c * error[..., 0]], axis=-1)
            / det[..., None]
        )
        ideal = ideal + np.clip(step, -0.3, 0.3)
    lost = ~(np.abs(error).max(axis=-1, keepdims=True) < 1e-9)
    return np.where(lost, np.nan, ideal)


def lens_parameter_names(distortion: Floats) -> tuple[str, ...]:
    """Names of the lens parameters in the order of the Jacobian's columns.
    distortion : (4, 5, 8, 12 or 14,)
    """
    return INTRINSICS + DISTORTION[: len(distortion)]


def _flat(points: Floats, matrix: Floats, distortion: Floats) -> tuple[Floats, Floats, Floats]:
    """(points (n, 3), matrix (3, 3), all terms (14,)), as kernels take them: one read-only would be compiled for
    anew.
    """
    terms = np.zeros(14)
    terms[: len(distortion)] = distortion
    return np.ascontiguousarray(np.reshape(points, (-1, 3)), float), np.array(matrix, float), terms


def _on_sensor(distorted: Floats, matrix: Floats, tilt: Floats) -> Floats:
    """Pixels (n, 2) of distorted coordinates (n, 2), by a tilted sensor."""
    return np.stack(_apply_tilt(tilt, *distorted.T), axis=-1) * [matrix[0, 0], matrix[1, 1]] + matrix[:2, 2]


def _derivatives_on_sensor(distorted: Floats, to_point: Floats, to_lens: Floats, matrix: Floats, tau: Floats) -> None:
    """Derivatives (n, 2, 3) and (n, 2, 18) of distorted coordinates (n, 2) become those of pixels, by a sensor tilted
    by tau (2,).
    """
    tilt, focal = _tilt(*tau), np.array([matrix[0, 0], matrix[1, 1]])[:, None]
    J = _tilt_jacobian(tilt, *distorted.T)
    to_point[:] = focal * (J @ to_point)
    to_lens[..., 4:16] = J @ to_lens[..., 4:16]
    for i in range(2):
        step = np.zeros(2, complex)
        step[i] = 1e-30j  # complex step: exact for this analytic function
        shifted = _apply_tilt(_tilt(*(tau + step)), *distorted.T)
        to_lens[:, 0, 16 + i], to_lens[:, 1, 16 + i] = shifted[0].imag / 1e-30, shifted[1].imag / 1e-30
    to_lens[..., 4:] *= focal
    to_lens[:, 0, 0], to_lens[:, 1, 1] = _apply_tilt(tilt, *distorted.T)


def _tilt(tau_x: complex, tau_y: complex) -> Floats:
    """(3, 3) map of a tilted sensor. Source: OpenCV computeTiltProjectionMatrix (Scheimpflug)."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    R = np.array([[cy, 0 * cy, -sy], [0 * cy, 1 + 0 * cy, 0 * cy], [sy, 0 * cy, cy]]) @ np.array(
        [[1 + 0 * cx, 0 * cx, 0 * cx], [0 * cx, cx, sx], [0 * cx, -sx, cx]]
    )
    lift = np.array([[R[2, 2], 0 * cx, -R[0, 2]], [0 * cx, R[2, 2], -R[1, 2]], [0 * cx, 0 * cx, 1 + 0 * cx]])
    return lift @ R


def _apply_tilt(tilt: Floats, xd: Floats, yd: Floats) -> tuple[Floats, Floats]:
    w = tilt[2, 0] * xd + tilt[2, 1] * yd + tilt[2, 2]
    return (tilt[0, 0] * xd + tilt[0, 1] * yd + tilt[0, 2]) / w, (tilt[1, 0] * xd + tilt[1, 1] * yd + tilt[1, 2]) / w


def _tilt_jacobian(tilt: Floats, xd: Floats, yd: Floats) -> Floats:
    xt, yt = _apply_tilt(tilt, xd, yd)
    w = tilt[2, 0] * xd + tilt[2, 1] * yd + tilt[2, 2]
    J = np.empty((*xd.shape, 2, 2))
    for i, value in enumerate((xt, yt)):
        for j in range(2):
            J[..., i, j] = (tilt[i, j] - value * tilt[2, j]) / w
    return J
