"""How likely samples are of a sum of two functions and noise, with the gradient: what size and smoothness are found by,
evaluation by evaluation.

Of the symmetric matrices one half is computed: distances once, the exponentials of all pairs in one go, the sums with
the inverse in one pass.
Source: Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, eqs 5.8 and 5.9
"""

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from rig.compute.numba_kernels import njit


class Likelihood:
    """Negative log likelihood of samples, but for a constant, as a function of the logarithms of size, length, size,
    length and noise.

    x : (n, axes) places; y : (n,) values; v : (n,) their stated variances; axis : the one that the first function is of
    """

    def __init__(self, x: np.ndarray, y: np.ndarray, v: np.ndarray, axis: int) -> None:
        self.y, self.v, self.work = y, v, np.zeros((len(y), len(y)), order="F")
        j, i = np.triu_indices(len(y), 1)  # pairs below the diagonal column by column, as LAPACK has them in memory
        self.gap = (x[i, axis] - x[j, axis]) ** 2
        square = (x**2).sum(axis=1)
        self.square = np.maximum(square[:, None] + square - 2 * x @ x.T, 0)[i, j]

    def __call__(self, p: np.ndarray) -> tuple[float, np.ndarray]:
        """(value, gradient (5,)) at p (5,). Raises LinAlgError where the covariance is not positive definite."""
        size1, length1, size2, length2, noise = np.exp(p)
        own, whole = (
            size1**2 * np.exp(self.gap * (-0.5 / length1**2)),
            size2**2 * np.exp(self.square * (-0.5 / length2**2)),
        )
        _fill(own, whole, self.v + noise**2 + size1**2 + size2**2, self.work)
        factor, bad = dpotrf(self.work, lower=1, clean=0, overwrite_a=1)
        if bad:
            raise np.linalg.LinAlgError(
                f"the covariance of {len(self.y)} samples is not positive definite at {np.exp(p).tolist()}"
            )
        determinant = np.log(np.diag(factor)).sum()
        inverse, _ = dpotri(factor, lower=1, overwrite_c=1)
        alpha = _times(inverse, self.y)
        sums = _sums(inverse, alpha, own, whole, self.gap, self.square)
        trace = sums[4]  # of the inverse less alpha alpha^T
        gradient = np.array(
            [
                2 * sums[0] + size1**2 * trace,
                sums[1] / length1**2,
                2 * sums[2] + size2**2 * trace,
                sums[3] / length2**2,
                noise**2 * trace,
            ]
        )
        return float(0.5 * self.y @ alpha + determinant), gradient


def noise_only(p: np.ndarray, y: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray]:
    """(value, gradient (1,)) of the same where noise alone is taken to be there, to its logarithm p (1,)."""
    total = v + np.exp(2 * p[0])
    value = 0.5 * np.sum(y**2 / total + np.log(total))
    return value, np.array([np.sum((1 / total - y**2 / total**2) * np.exp(2 * p[0]))])


@njit(cache=True, nogil=True)
def _fill(own: np.ndarray, whole: np.ndarray, diagonal: np.ndarray, K: np.ndarray) -> None:
    """The lower triangle of K (n, n) from what its pairs below the diagonal (n (n - 1) / 2,) have, column by column,
    and its diagonal (n,).
    """
    at = 0
    for j in range(len(K)):
        K[j, j] = diagonal[j]
        for i in range(j + 1, len(K)):
            K[i, j] = own[at] + whole[at]
            at += 1


@njit(cache=True, nogil=True)
def _times(K: np.ndarray, y: np.ndarray) -> np.ndarray:
    """K y (n,) of the lower triangle of a symmetric K (n, n)."""
    out = np.zeros(len(y))
    for j in range(len(y)):
        total = K[j, j] * y[j]
        for i in range(j + 1, len(y)):
            total += K[i, j] * y[i]
            out[i] += K[i, j] * y[j]
        out[j] += total
    return out


@njit(cache=True, nogil=True)
def _sums(
    inverse: np.ndarray, alpha: np.ndarray, own: np.ndarray, whole: np.ndarray, gap: np.ndarray, square: np.ndarray
) -> np.ndarray:
    """(5,) sums over the pairs below the diagonal of M = inverse - alpha alpha^T times own, own gap, whole, whole
    square; and the trace of M.
    """
    out, at = np.zeros(5), 0
    for j in range(len(alpha)):
        for i in range(j + 1, len(alpha)):
            m = inverse[i, j] - alpha[i] * alpha[j]
            a, b = m * own[at], m * whole[at]
            out[0] += a
            out[1] += a * gap[at]
            out[2] += b
            out[3] += b * square[at]
            at += 1
        out[4] += inverse[j, j] - alpha[j] ** 2
    return out
