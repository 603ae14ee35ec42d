"""Polynomial fields, and sums of one function per axis.

The functions of axes are piecewise linear; both are fitted by least squares.

How many knots an axis gets is what the samples bear out (Bayesian information criterion). Source: configuration-space
patent, [0137]; the on-line learning patent for Stewart platforms, [0011] to [0015], learns along one axis after the
other likewise

Source: configuration-space patent, [0137] (a suitable fit of the values)
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import comb
from typing import ClassVar, Self, TypeVar

import numpy as np

from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    merge_repeated_samples,
)
from rig.array_and_json_types import Booleans, Floats, Integers

EMPTY = np.zeros(0)
RANK = 1e-10  # of the largest singular value; directions below are not told by the samples and left at zero


class RegressionField:
    """A field of a sum of functions. Who inherits it has low, high (axes,), the box of the samples, beyond which it
    goes on as on its faces; coefficients (functions, outputs); root (functions, k), whose root root^T is the
    coefficients' covariance in units of the noise; noise (outputs,), the standard deviation of a sample about it, and
    misfit (outputs,), that part of it which is the field's."""

    __slots__ = ()
    low: Floats
    high: Floats
    coefficients: Floats
    root: Floats
    noise: Floats
    misfit: Floats

    def functions(self, x: Floats) -> Floats:
        """(n, functions) at places x (n, axes) of the box."""
        raise NotImplementedError

    def slopes(self, x: Floats) -> Floats:
        """(n, functions, axes) their change with x (n, axes)."""
        raise NotImplementedError

    def value(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        inner = np.clip(x, self.low, self.high).reshape(-1, x.shape[-1])
        return (self.functions(inner) @ self.coefficients).reshape(*x.shape[:-1], -1)

    def gradient(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        inner = np.clip(x, self.low, self.high)
        out = np.einsum("nfd,fm->nmd", self.slopes(inner.reshape(-1, x.shape[-1])), self.coefficients)
        return out.reshape(*x.shape[:-1], -1, x.shape[-1]) * (inner == x)[..., None, :]

    def error(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        inner = np.clip(x, self.low, self.high).reshape(-1, x.shape[-1])
        leverage = ((self.functions(inner) @ self.root) ** 2).sum(axis=1)
        beyond = np.linalg.norm((inner - x.reshape(inner.shape)) / ((self.high - self.low) / 2), axis=1)
        middle = self.functions((self.low + self.high)[None] / 2)
        size = np.abs(
            (self.functions(inner) - middle) @ self.coefficients
        )  # as far as it goes over half the box, so far it may go on
        square = leverage[:, None] * self.noise**2 + self.misfit**2 + (beyond[:, None] * size) ** 2
        return np.sqrt(square).reshape(*x.shape[:-1], -1)

    def inside(self, x: Floats) -> Booleans:
        return np.asarray(((x >= self.low) & (x <= self.high)).all(axis=-1))


R = TypeVar("R", bound=RegressionField)


def _most_likely_field(blanks: Iterable[R], known: FieldSamples) -> R:
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


def _shares(functions: Floats, known: FieldSamples) -> tuple[Floats, Floats, Floats, Floats, float]:
    """(coefficients, root, noise, misfit, Bayesian information criterion) of functions (n, f) fitted to the values of n
    samples.
    """
    n, count = functions.shape
    U, s, Vt = np.linalg.svd(functions, full_matrices=False)
    determined = s > RANK * s[0]
    root = Vt[determined].T / s[determined]
    coefficients = root @ (U[:, determined].T @ known.values)
    left = ((known.values - functions @ coefficients) ** 2).sum(axis=0)
    rank = int(determined.sum())
    variance = left / max(n - rank, 1)
    stated = known.variances.mean(axis=0)
    noise = np.sqrt(np.maximum(variance, stated))
    misfit = np.sqrt(np.maximum(variance - stated, 0))
    bic = float(
        n * np.log(np.maximum(left / n, 0.1 * stated + 1e-300)).sum() + rank * known.values.shape[1] * np.log(n)
    )
    return coefficients, root, noise, misfit, bic


KNOTS = (2, 3, 5, 9, 17, 33)  # tried
SAMPLES_PER_KNOT = 2  # for each knot, at the least


@dataclass(frozen=True, slots=True, eq=False)
class AxisFunctions(RegressionField):
    """knots : (axes, count), ascending along each axis; coefficients : (axes count, outputs), axis after axis; the rest
    as Regressed has it.
    """

    knots: Floats
    coefficients: Floats
    root: Floats
    noise: Floats
    misfit: Floats
    kind: ClassVar[str] = "axes"
    exact: ClassVar[bool] = False

    @property
    def low(self) -> Floats:  # type: ignore[override]
        """(axes,) first knots."""
        return self.knots[:, 0]

    @property
    def high(self) -> Floats:  # type: ignore[override]
        """(axes,) last knots."""
        return self.knots[:, -1]

    @classmethod
    def fit(cls, known: FieldSamples) -> Self:
        """The sum of functions with as many knots as is likeliest, through samples anywhere; knots where samples lie
        equally dense.
        """
        each = merge_repeated_samples(known)
        n, axes = each.configurations.shape
        counts = [count for count in KNOTS if count == KNOTS[0] or SAMPLES_PER_KNOT * axes * count <= n]
        return _most_likely_field(
            (
                cls(
                    np.array([_knots(each.configurations[:, i], count, known.strokes[i]) for i in range(axes)]),
                    *[EMPTY] * 4,
                )
                for count in counts
            ),
            each,
        )

    def functions(self, x: Floats) -> Floats:
        out = np.zeros((len(x), *self.knots.shape))
        for i, (cell, t, _) in enumerate(self._cells(x)):
            out[np.arange(len(x)), i, cell], out[np.arange(len(x)), i, cell + 1] = 1 - t, t
        return out.reshape(len(x), -1)

    def slopes(self, x: Floats) -> Floats:
        out = np.zeros((len(x), *self.knots.shape, x.shape[1]))
        for i, (cell, _, width) in enumerate(self._cells(x)):
            out[np.arange(len(x)), i, cell, i], out[np.arange(len(x)), i, cell + 1, i] = -1 / width, 1 / width
        return out.reshape(len(x), -1, x.shape[1])

    def _cells(self, x: Floats) -> list[tuple[Integers, Floats, Floats]]:
        """Per axis (cell (n,), place in it 0..1 (n,), its width (n,))."""
        out: list[tuple[Integers, Floats, Floats]] = []
        for i, knots in enumerate(self.knots):
            cell = np.clip(np.searchsorted(knots, x[:, i], side="right") - 1, 0, len(knots) - 2)
            width = np.diff(knots)[cell]
            out.append((cell, (x[:, i] - knots[cell]) / width, width))
        return out


def _knots(values: Floats, count: int, stroke: Floats) -> Floats:
    """(count,) ascending, from the least to the greatest sample: half even, half where samples are, so that none
    coincide.
    """
    low, high = values.min(), values.max()
    if high <= low:
        high = low + np.ptp(stroke)
    even = np.linspace(low, high, count)
    return (
        (even + np.quantile(np.append(values, [low, high]), np.linspace(0, 1, count))) / 2
        if np.ptp(values) > 0
        else even
    )


MOST = 4  # total degree
SAMPLES_PER_TERM = 2  # for each of the polynomial's terms, at the least


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial(RegressionField):
    """powers : (terms, axes) whole numbers, of coordinates that go from -1 to 1 over the box low..high; the rest as
    Regressed has it.
    """

    low: Floats
    high: Floats
    powers: Floats
    coefficients: Floats
    root: Floats
    noise: Floats
    misfit: Floats
    kind: ClassVar[str] = "polynomial"
    exact: ClassVar[bool] = False

    @classmethod
    def fit(cls, known: FieldSamples) -> Self:
        """The polynomial of the likeliest degree through samples anywhere."""
        each = merge_repeated_samples(known)
        n, axes = each.configurations.shape
        low, high = each.configurations.min(axis=0), each.configurations.max(axis=0)
        high = np.where(high > low, high, low + np.ptp(known.strokes, axis=1))
        degrees = [
            degree for degree in range(MOST + 1) if not degree or SAMPLES_PER_TERM * comb(axes + degree, degree) <= n
        ]
        return _most_likely_field((cls(low, high, _powers(axes, degree), *[EMPTY] * 4) for degree in degrees), each)

    def functions(self, x: Floats) -> Floats:
        u = self._scaled(x)
        return np.prod(u[:, None] ** self.powers, axis=2)

    def slopes(self, x: Floats) -> Floats:
        u, out = self._scaled(x), np.empty((len(x), *self.powers.shape))
        for i in range(x.shape[1]):
            lower = self.powers.copy()
            lower[:, i] = np.maximum(lower[:, i] - 1, 0)
            out[..., i] = self.powers[:, i] * np.prod(u[:, None] ** lower, axis=2)
        return out * 2 / (self.high - self.low)

    def _scaled(self, x: Floats) -> Floats:
        return (2 * x - self.low - self.high) / (self.high - self.low)


def _powers(axes: int, degree: int) -> Floats:
    """(terms, axes) of all monomials up to a total degree."""
    terms = [chosen for total in range(degree + 1) for chosen in combinations_with_replacement(range(axes), total)]
    return np.array([[chosen.count(i) for i in range(axes)] for chosen in terms]).reshape(len(terms), axes)
