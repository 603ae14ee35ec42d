"""Gaussian process interpolation of noisy samples.

Of correction summands, and the likelihood of its parameters.

Of the symmetric matrices one half is computed: distances once, the exponentials of all pairs in one go, the sums with
the inverse in one pass. Source: Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, eqs 5.8 and
5.9

The summand of a strut is the sum of a function of that strut's own command (screw, encoder, scale) and a function of
the whole configuration; how large and how smooth either is, is found by maximum likelihood. Far from any sample it
fades to zero, which leaves the fitted geometry alone. Source: Rasmussen and Williams, Gaussian Processes for Machine
Learning, 2006, eqs 2.25, 2.30, 5.9.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import scipy
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotrf, dpotri

from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    merge_repeated_samples,
)
from rig.array_and_json_types import Booleans, Floats
from rig.compute.numba_compilation_and_kernel_cache_folder import njit


class Likelihood:
    """Negative log likelihood of samples, but for a constant, as a function of the logarithms of size, length, size,
    length and noise.

    x : (n, axes) places; y : (n,) values; v : (n,) their stated variances; axis : the one that the first function is of
    """

    def __init__(self, x: Floats, y: Floats, v: Floats, axis: int) -> None:
        self.y, self.v, self.work = y, v, np.zeros((len(y), len(y)), order="F")
        j, i = np.triu_indices(len(y), 1)  # pairs below the diagonal column by column, as LAPACK has them in memory
        self.gap = (x[i, axis] - x[j, axis]) ** 2
        square = (x**2).sum(axis=1)
        self.square = np.maximum(square[:, None] + square - 2 * x @ x.T, 0)[i, j]

    def __call__(self, p: Floats) -> tuple[float, Floats]:
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


def _noise_only(p: Floats, y: Floats, v: Floats) -> tuple[float, Floats]:
    """(value, gradient (1,)) of the same where noise alone is taken to be there, to its logarithm p (1,)."""
    total = v + np.exp(2 * p[0])
    value = 0.5 * np.sum(y**2 / total + np.log(total))
    return value, np.array([np.sum((1 / total - y**2 / total**2) * np.exp(2 * p[0]))])


@njit(cache=True, nogil=True)
def _fill(own: Floats, whole: Floats, diagonal: Floats, K: Floats) -> None:
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
def _times(K: Floats, y: Floats) -> Floats:
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
def _sums(inverse: Floats, alpha: Floats, own: Floats, whole: Floats, gap: Floats, square: Floats) -> Floats:
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


LARGEST = 400  # samples on which size and smoothness are found; more are thinned out for that
STARTS = ((0.1, 1.5), (0.6, 1.5))  # smoothness to start from, in half strokes: along the strut, over the configuration
OWN, WHOLE = np.log([0.02, 10.0]), np.log([0.7, 10.0])  # in six dimensions hundreds of samples resolve nothing finer
BOUNDS = ((-12, 5), OWN, (-12, 5), WHOLE, (-12, 5))


@dataclass(frozen=True, slots=True, eq=False)
class Radial:
    """centre, half : (axes,) scale of the configuration space; axis : the strut's index; inputs : (n, axes) scaled;
    weights : (n,) m; sizes : (2,) m and lengths : (2,) half strokes of the two functions; noise : m beyond what was
        stated
    variances : (n,) m^2 of the samples as stated, None in files of before they were kept."""

    centre: Floats
    half: Floats
    axis: int
    inputs: Floats
    weights: Floats
    sizes: Floats
    lengths: Floats
    noise: float
    variances: Floats | None = None

    def __call__(self, configurations: Floats) -> Floats:
        """(...,) m, the summand at configurations (..., axes)."""
        scaled = (np.asarray(configurations, float) - self.centre) / self.half
        flat = scaled.reshape(-1, scaled.shape[-1])
        own, whole = _kernels(flat, self.inputs, self.axis, self.lengths)
        values = (self.sizes[0] ** 2 * own + self.sizes[1] ** 2 * whole) @ self.weights
        return values.reshape(scaled.shape[:-1])

    def gradient(self, configurations: Floats) -> Floats:
        """(..., axes) change of the summand with configurations (..., axes)."""
        scaled = (np.asarray(configurations, float) - self.centre) / self.half
        flat = scaled.reshape(-1, scaled.shape[-1])
        own, whole = (
            size**2 * kernel * self.weights
            for size, kernel in zip(self.sizes, _kernels(flat, self.inputs, self.axis, self.lengths))
        )
        out = (whole @ self.inputs - whole.sum(axis=1)[:, None] * flat) / self.lengths[1] ** 2
        out[:, self.axis] += (own @ self.inputs[:, self.axis] - own.sum(axis=1) * flat[:, self.axis]) / self.lengths[
            0
        ] ** 2
        return (out / self.half).reshape(scaled.shape)

    def error(self, configurations: Floats) -> Floats:
        """(...,) m, standard error at configurations (..., axes): Rasmussen and Williams, eq. 2.26; the sizes alone
        where no variances are kept.
        """
        scaled = (np.asarray(configurations, float) - self.centre) / self.half
        square = np.full(scaled.shape[:-1], (self.sizes**2).sum())
        if self.variances is not None:
            flat = scaled.reshape(-1, scaled.shape[-1])
            k = self._covariance(flat)
            K = self._covariance(self.inputs) + np.diag(self.variances + self.noise**2)
            explained = np.einsum("ni,in->n", k, cho_solve(cho_factor(K, lower=True), k.T))
            square = np.maximum(square - explained.reshape(square.shape), 0)
        return np.sqrt(square)

    def _covariance(self, scaled: Floats) -> Floats:
        own, whole = _kernels(scaled, self.inputs, self.axis, self.lengths)
        return self.sizes[0] ** 2 * own + self.sizes[1] ** 2 * whole


@dataclass(frozen=True, slots=True, eq=False)
class RadialMap:
    """A Radial for each output, None for one that noise alone explains; low, high : (axes,), the box of the samples.

    inflation : times its own standard error that it was found to be off at samples held out, where that is more
    """

    parts: tuple[Radial | None, ...]
    low: Floats
    high: Floats
    inflation: float = 1.0
    kind: ClassVar[str] = "radial"
    exact: ClassVar[bool] = False

    @classmethod
    def fit(cls, known: FieldSamples, like: "RadialMap | None" = None) -> Self:
        """The field through samples anywhere; output i may have a function of its own along axis i. Raises ValueError
        for more outputs than axes.

        like : a RadialMap whose sizes and smoothness are taken over, or None
        """
        each = merge_repeated_samples(known)
        x, axes = each.configurations, each.configurations.shape[1]
        if each.values.shape[1] > axes:
            raise ValueError(f"radial accepts at most as many outputs as axes, got {each.values.shape[1]} and {axes}")
        parts = tuple(
            None
            if like is not None and like.parts[i] is None
            else fit_gaussian_process(
                x, each.values[:, i], each.variances[:, i], i, each.strokes, None if like is None else like.parts[i]
            )
            for i in range(each.values.shape[1])
        )
        return cls(parts, x.min(axis=0), x.max(axis=0))

    def value(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        return np.stack([np.zeros(x.shape[:-1]) if part is None else part(x) for part in self.parts], axis=-1)

    def gradient(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        return np.stack([np.zeros(x.shape) if part is None else part.gradient(x) for part in self.parts], axis=-2)

    def error(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        return self.inflation * np.stack(
            [np.zeros(x.shape[:-1]) if part is None else part.error(x) for part in self.parts], axis=-1
        )

    def inside(self, x: Floats) -> Booleans:
        return np.asarray(((x >= self.low) & (x <= self.high)).all(axis=-1))


def fit_gaussian_process(
    configurations: Floats,
    values: Floats,
    variances: Floats,
    axis: int,
    strokes: Floats,
    hyperparameters_from: Radial | None = None,
) -> Radial | None:
    """Gaussian process fitted to noisy samples.

    They are of summands; None where noise alone explains them (BIC).
    configurations : (n, axes) m; values : (n,) m; variances : (n,) m^2, stated; axis : the strut's index
    strokes : (axes, 2) m, the configuration space; hyperparameters_from : a Radial whose sizes, lengths and noise are
        taken over, or None
    """
    centre, half = strokes.mean(axis=1), np.ptp(strokes, axis=1) / 2
    scaled = (configurations - centre) / half
    unit = max(float(np.sqrt(np.mean(variances))), 1e-12)
    y, v = values / unit, variances / unit**2
    if hyperparameters_from is None:
        hyper = _hyper(scaled, y, v, axis)
        if hyper is None:
            return None
        sizes, lengths, noise = hyper[[0, 2]], hyper[[1, 3]], hyper[4]
    else:
        sizes, lengths, noise = (
            hyperparameters_from.sizes / unit,
            hyperparameters_from.lengths,
            hyperparameters_from.noise / unit,
        )
    own, whole = _kernels(scaled, scaled, axis, lengths)
    K = sizes[0] ** 2 * own + sizes[1] ** 2 * whole + np.diag(v + noise**2)
    weights = cho_solve(cho_factor(K, lower=True), y)
    return Radial(centre, half, axis, scaled, weights / unit, sizes * unit, lengths, float(noise * unit), variances)


def _hyper(scaled: Floats, y: Floats, v: Floats, axis: int) -> Floats | None:
    """(5,) size, length, size, length, noise of greatest likelihood, or None where noise alone is likelier for its
    simplicity.
    """
    thin = np.arange(0, len(y), max(1, -(-len(y) // LARGEST)))
    likelihood = Likelihood(scaled[thin], y[thin], v[thin], axis)
    fits = [
        scipy.optimize.minimize(
            likelihood,
            np.array([0.0, np.log(own), 0.0, np.log(whole), -2.0]),
            jac=True,
            method="L-BFGS-B",
            bounds=BOUNDS,
            options={"maxiter": 40},
        )
        for own, whole in STARTS
    ]
    best = min(fits, key=lambda fit: fit.fun)
    null = scipy.optimize.minimize(
        lambda p: _noise_only(p, y[thin], v[thin]), [-2.0], jac=True, method="L-BFGS-B", bounds=BOUNDS[-1:]
    )
    return (
        None if null.fun - best.fun < 2 * np.log(len(thin)) else np.exp(best.x)
    )  # four more parameters at log(n)/2 each


def _kernels(a: Floats, b: Floats, axis: int, lengths: Floats) -> tuple[Floats, Floats]:
    own = np.exp(-0.5 * ((a[:, None, axis] - b[None, :, axis]) / lengths[0]) ** 2)
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return own, np.exp(-0.5 * np.maximum(square, 0) / lengths[1] ** 2)
