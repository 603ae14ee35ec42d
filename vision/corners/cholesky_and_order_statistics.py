"""Cholesky factor and solution of small systems, and order statistics, as numba kernels."""

import math

from rig.array_types import Floats
from vision.corners.numba_compilation import kernel


@kernel
def cholesky_factor(H: Floats, first: int, size: int, L: Floats) -> bool:
    """Write the Cholesky factor of H[first:first + size, first:first + size] into L; False if not definite.

    H, L : (n, n)
    """
    for i in range(size):
        for j in range(i + 1):
            total = H[first + i, first + j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 1e-9 * H[first + i, first + i]:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@kernel
def cholesky_solve(L: Floats, size: int, b: Floats, x: Floats) -> None:
    """Solve L L' x = b for x (size,), with the Cholesky factor L."""
    for i in range(size):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(size - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, size):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


HALVINGS = 14  # of the numbers' range


@kernel
def order_statistic(values: Floats, rank: int) -> float:
    """Order statistic of values (k,): the one of that rank, to a 16 000th of their range; 0 for none."""
    if len(values) == 0:
        return 0.0
    low = high = float(values[0])
    for value in values:
        low, high = min(low, value), max(high, value)
    for _ in range(HALVINGS):
        middle, below = 0.5 * (low + high), 0
        for value in values:
            below += value < middle
        low, high = (middle, high) if below <= rank else (low, middle)
    return high
