"""What is seen, point by point, compiled: carried by the platform, through a lens without a tilted sensor, and how
pixels change with both.
"""

import numpy as np

from rig.compute.numba_kernels import njit


@njit(cache=True, nogil=True, error_model="numpy")
def project(points: np.ndarray, matrix: np.ndarray, k: np.ndarray, uv: np.ndarray) -> None:
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
def derivatives(
    points: np.ndarray, matrix: np.ndarray, k: np.ndarray, uv: np.ndarray, to_point: np.ndarray, to_lens: np.ndarray
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
def carried(points: np.ndarray, T: np.ndarray, frame: np.ndarray, some: np.ndarray, out: np.ndarray) -> None:
    """Into out (n, 3) m some (n,) of the points (n, 3) m moved by T (F, 4, 4) of their frame (n,), the others as they
    are.
    """
    for n in range(len(points)):
        for i in range(3):
            out[n, i] = points[n, i]
            if some[n]:
                M = T[frame[n]]
                out[n, i] = M[i, 0] * points[n, 0] + M[i, 1] * points[n, 1] + M[i, 2] * points[n, 2] + M[i, 3]
