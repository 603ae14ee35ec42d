"""Rotation increment, compiled: a rotation matrix multiplied in place by that of a small rotation vector."""

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Floats
from rig.compute.numba_kernels import njit


@njit(cache=True, nogil=True)
def rotate_increment(R: Floats, w: NDArray[np.floating]) -> None:
    """Rotate R (3, 3) in place by the increment w (3,), a rotation vector: R becomes R exp(w)."""
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
