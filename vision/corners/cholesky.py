"""Small symmetric systems inside kernels."""

import math

import numpy as np

from vision.corners.numba_compilation import kernel


@kernel
def factor(H: np.ndarray, first: int, size: int, L: np.ndarray) -> bool:
    """Cholesky factor of H[first:first + size, first:first + size] into L (size, size); False where that is not
    definite.
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
def solve(L: np.ndarray, size: int, b: np.ndarray, x: np.ndarray) -> None:
    """x (size,) that L L' sends to b (size,); L : of `factor`."""
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
