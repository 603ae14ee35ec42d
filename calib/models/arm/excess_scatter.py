"""How much poses scatter beyond what their instrument says, told from the middle of the residuals so that a few wild
ones say little.
"""

import numpy as np
from scipy.special import chdtri

MIDDLE = float(chdtri(3, 0.5))  # of the squared length of three normal numbers
FAR = 1e-3  # chance of a length beyond which a pose counts less
EXCESS = 3.0  # standard errors by which scatter must exceed the instrument's own before it counts


def beyond(left: np.ndarray, own: np.ndarray, share: float | np.ndarray = 0.0) -> np.ndarray:
    """(k,) m and rad, scatter per number beyond the instrument's own: one figure for three positions, one for three
    rotations.

    left : (m, k) residuals, m and rad; own : (m, k, k) the instrument's covariance; share : of the squares, what the
    fit took away, one figure or one for positions and one for rotations
    """
    out = np.zeros(left.shape[1])
    for part, fitted in zip((slice(0, 3), slice(3, 6)), np.broadcast_to(share, 2)):
        if left[:, part].size:
            length, stated = (left[:, part] ** 2).sum(axis=1), float(np.einsum("mkk->mk", own)[:, part].mean())
            count = min(3, left.shape[1])
            middle = max(float(np.median(length)) / (MIDDLE if count == 3 else float(chdtri(count, 0.5))), stated)
            tail = bounded(length / middle, count)
            seen = float(tail @ length) / float(tail.sum()) / count / (1 - float(fitted))
            chance = (
                np.sqrt(2 * (own[:, part, part] ** 2).sum()) / left[:, part].size
            )  # of a mean of squares of poses that are not alike
            if seen > stated + EXCESS * chance:
                out[part] = np.sqrt(seen - stated)
    return out


def bounded(length: np.ndarray, count: int) -> np.ndarray:
    """(m,) weights of poses by the squared length (m,) of their `count` whitened numbers: 1 up to what noise shows,
    beyond so that weight times length stays the same. No wild pose counts for more than the wildest of noise, and none
    is thrown away before all is explained."""
    return np.minimum(1.0, float(chdtri(count, FAR)) / np.maximum(length, 1e-300))
