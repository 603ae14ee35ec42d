"""Fields that are sums of functions, their shares found by least squares: value, gradient and error estimate from the
functions.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from calib.correct.interpolation.field import Known

EMPTY = np.zeros(0)
RANK = 1e-10  # of the largest singular value; directions below are not told by the samples and left at zero


class Regressed:
    """A field of a sum of functions. Who inherits it has low, high (axes,), the box of the samples, beyond which it
    goes on as on its faces; coefficients (functions, outputs); root (functions, k), whose root root^T is the
    coefficients' covariance in units of the noise; noise (outputs,), the standard deviation of a sample about it, and
    misfit (outputs,), that part of it which is the field's."""

    __slots__ = ()
    low: np.ndarray
    high: np.ndarray
    coefficients: np.ndarray
    root: np.ndarray
    noise: np.ndarray
    misfit: np.ndarray

    def functions(self, x: np.ndarray) -> np.ndarray:
        """(n, functions) at places x (n, axes) of the box."""
        raise NotImplementedError

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """(n, functions, axes) their change with x (n, axes)."""
        raise NotImplementedError

    def value(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        inner = np.clip(x, self.low, self.high).reshape(-1, x.shape[-1])
        return (self.functions(inner) @ self.coefficients).reshape(*x.shape[:-1], -1)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        inner = np.clip(x, self.low, self.high)
        out = np.einsum("nfd,fm->nmd", self.slopes(inner.reshape(-1, x.shape[-1])), self.coefficients)
        return out.reshape(*x.shape[:-1], -1, x.shape[-1]) * (inner == x)[..., None, :]

    def error(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        inner = np.clip(x, self.low, self.high).reshape(-1, x.shape[-1])
        told = ((self.functions(inner) @ self.root) ** 2).sum(axis=1)
        beyond = np.linalg.norm((inner - x.reshape(inner.shape)) / ((self.high - self.low) / 2), axis=1)
        middle = self.functions((self.low + self.high)[None] / 2)
        size = np.abs(
            (self.functions(inner) - middle) @ self.coefficients
        )  # as far as it goes over half the box, so far it may go on
        square = told[:, None] * self.noise**2 + self.misfit**2 + (beyond[:, None] * size) ** 2
        return np.sqrt(square).reshape(*x.shape[:-1], -1)

    def inside(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(((x >= self.low) & (x <= self.high)).all(axis=-1))


R = TypeVar("R", bound=Regressed)


def most_likely_field(blanks: Iterable[R], known: Known) -> R:
    """The field, of some whose shares are not found yet, the simplest first, that is likeliest once these are fitted to
    samples.
    """
    best, least = None, np.inf
    for blank in blanks:
        coefficients, root, noise, misfit, bic = _shares(blank.functions(known.configurations), known)
        if best is None or bic < least:
            fitted = {"coefficients": coefficients, "root": root, "noise": noise, "misfit": misfit}
            best, least = replace(blank, **fitted), bic  # type: ignore[type-var]
    assert best is not None
    return best


def _shares(functions: np.ndarray, known: Known) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """(coefficients, root, noise, misfit, Bayesian information criterion) of functions (n, f) fitted to the values of n
    samples.
    """
    n, count = functions.shape
    U, s, Vt = np.linalg.svd(functions, full_matrices=False)
    told = s > RANK * s[0]
    root = Vt[told].T / s[told]
    coefficients = root @ (U[:, told].T @ known.values)
    left = ((known.values - functions @ coefficients) ** 2).sum(axis=0)
    rank = int(told.sum())
    variance = left / max(n - rank, 1)
    stated = known.variances.mean(axis=0)
    noise = np.sqrt(np.maximum(variance, stated))
    misfit = np.sqrt(np.maximum(variance - stated, 0))
    bic = float(
        n * np.log(np.maximum(left / n, 0.1 * stated + 1e-300)).sum() + rank * known.values.shape[1] * np.log(n)
    )
    return coefficients, root, noise, misfit, bic
