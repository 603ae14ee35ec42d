"""Sums over observed corners, compiled: of rows that lie scattered in what all corners have, without gathering them
first.
"""

from rig.arrays import Floats, Integers
from rig.compute.numba_kernels import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _row_projection(table: Floats, rows: Integers, V: Floats, out: Floats) -> None:
    """Into out (q, p) V^T times the rows (h,) of a table (n, p); V : (h, q)."""
    out[:] = 0.0
    for h in range(len(rows)):
        part = table[rows[h]]
        for i in range(V.shape[1]):
            v = V[h, i]
            for j in range(len(part)):
                out[i, j] += v * part[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _row_projection_by_frame(local: Floats, rows: Integers, frame: Integers, V: Floats, out: Floats) -> None:
    """Into out (F, L, q), frame by frame, the rows (h,) of local (n, L) transposed times V (h, q); frame : (h,)"""
    out[:] = 0.0
    for h in range(len(rows)):
        for k in range(local.shape[1]):
            v = local[rows[h], k]
            for i in range(V.shape[1]):
                out[frame[h], k, i] += v * V[h, i]
