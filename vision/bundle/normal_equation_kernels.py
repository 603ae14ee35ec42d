"""What adjustments do corner by corner, compiled: derivatives to motions, whitening, and sums of normal equations."""

import numpy as np

from rig.compute.numba_kernels import njit


@njit(cache=True, nogil=True, error_model="numpy")
def motion_derivatives(J: np.ndarray, points: np.ndarray, out: np.ndarray) -> None:
    """Into out (n, 2, 6) the derivatives to small motions on the right, from those J (n, 2, 3) to the points (n, 3)
    that they move.
    """
    for n in range(len(J)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for c in range(2):
            a, b, d = J[n, c, 0], J[n, c, 1], J[n, c, 2]
            out[n, c, 0], out[n, c, 1], out[n, c, 2] = a, b, d
            out[n, c, 3], out[n, c, 4], out[n, c, 5] = y * d - z * b, z * a - x * d, x * b - y * a


@njit(cache=True, nogil=True, error_model="numpy")
def rotate_derivatives(J: np.ndarray, R: np.ndarray, at: np.ndarray, some: np.ndarray, out: np.ndarray) -> None:
    """Into out (n, 2, 3) J (n, 2, 3) times the matrix of R (m, 3, 3) that each is `at` (n,), or J itself but for `some`
    (n,).
    """
    for n in range(len(J)):
        for c in range(2):
            for k in range(3):
                out[n, c, k] = J[n, c, k]
                if some[n]:
                    out[n, c, k] = (
                        J[n, c, 0] * R[at[n], 0, k] + J[n, c, 1] * R[at[n], 1, k] + J[n, c, 2] * R[at[n], 2, k]
                    )


@njit(cache=True, nogil=True, error_model="numpy")
def whiten(own: np.ndarray, scale: np.ndarray, marker: np.ndarray, rows: np.ndarray) -> None:
    """Rows (n, 2, k) of each corner become own (n, 2, 2) times themselves, column by column in the scale (markers, k)
    of its marker (n,).
    """
    for n in range(len(rows)):
        for k in range(rows.shape[2]):
            u, v = rows[n, 0, k] * scale[marker[n], k], rows[n, 1, k] * scale[marker[n], k]
            rows[n, 0, k] = own[n, 0, 0] * u + own[n, 0, 1] * v
            rows[n, 1, k] = own[n, 1, 0] * u + own[n, 1, 1] * v


@njit(cache=True, nogil=True, error_model="numpy")
def add_corners(
    rows: np.ndarray,
    frame: np.ndarray,
    marker: np.ndarray,
    own_columns: np.ndarray,
    shared_columns: np.ndarray,
    sums: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Add a camera's corners to sums (local (F, l, l), cross (F, l, s), shared (s, s), own (F, l), common (s,)) of
    normal equations.

    rows : (n, 2, k + w + 1) derivatives to unknowns of the corner's frame, to shared ones, and residual;
        frame, marker : (n,), each sighting's
    corners together; own_columns : (k,); shared_columns : (markers, w)
    """
    local, cross, shared, own, common = sums
    k, w = len(own_columns), shared_columns.shape[1]
    width = k + w + 1
    square = np.zeros((width, width))
    for n in range(len(rows)):
        for c in range(2):
            for a in range(width):
                for b in range(a + 1):
                    square[a, b] += rows[n, c, a] * rows[n, c, b]
        if n + 1 < len(rows) and frame[n + 1] == frame[n] and marker[n + 1] == marker[n]:
            continue
        f, columns = frame[n], shared_columns[marker[n]]
        for a in range(k):
            own[f, own_columns[a]] += square[width - 1, a]
            for b in range(a + 1):
                local[f, own_columns[a], own_columns[b]] += square[a, b]
                if a != b:
                    local[f, own_columns[b], own_columns[a]] += square[a, b]
        for a in range(w):
            at = columns[a]
            common[at] += square[width - 1, k + a]
            for b in range(k):
                cross[f, own_columns[b], at] += square[k + a, b]
            for b in range(a + 1):
                shared[at, columns[b]] += square[k + a, k + b]
                if a != b:
                    shared[columns[b], at] += square[k + a, k + b]
        square[:] = 0.0
