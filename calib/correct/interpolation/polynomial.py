"""A polynomial of all axes, of the total degree that the samples bear out (Bayesian information criterion), by least
squares.

Source: configuration-space patent, [0137] (a suitable fit of the values)
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import comb
from typing import ClassVar, Self

import numpy as np

from calib.correct.interpolation.field import Known, merge_repeats
from calib.correct.interpolation.regression_fields import EMPTY, Regressed, most_likely_field

MOST = 4  # total degree
SAMPLES = 2  # for each of the polynomial's terms, at the least


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial(Regressed):
    """powers : (terms, axes) whole numbers, of coordinates that go from -1 to 1 over the box low..high; the rest as
    Regressed has it.
    """

    low: np.ndarray
    high: np.ndarray
    powers: np.ndarray
    coefficients: np.ndarray
    root: np.ndarray
    noise: np.ndarray
    misfit: np.ndarray
    kind: ClassVar[str] = "polynomial"
    exact: ClassVar[bool] = False

    @classmethod
    def fit(cls, known: Known) -> Self:
        """The polynomial of the likeliest degree through samples anywhere."""
        each = merge_repeats(known)
        n, axes = each.configurations.shape
        low, high = each.configurations.min(axis=0), each.configurations.max(axis=0)
        high = np.where(high > low, high, low + np.ptp(known.strokes, axis=1))
        degrees = [degree for degree in range(MOST + 1) if not degree or SAMPLES * comb(axes + degree, degree) <= n]
        return most_likely_field((cls(low, high, _powers(axes, degree), *[EMPTY] * 4) for degree in degrees), each)

    def functions(self, x: np.ndarray) -> np.ndarray:
        u = self._scaled(x)
        return np.prod(u[:, None] ** self.powers, axis=2)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        u, out = self._scaled(x), np.empty((len(x), *self.powers.shape))
        for i in range(x.shape[1]):
            lower = self.powers.copy()
            lower[:, i] = np.maximum(lower[:, i] - 1, 0)
            out[..., i] = self.powers[:, i] * np.prod(u[:, None] ** lower, axis=2)
        return out * 2 / (self.high - self.low)

    def _scaled(self, x: np.ndarray) -> np.ndarray:
        return (2 * x - self.low - self.high) / (self.high - self.low)


def _powers(axes: int, degree: int) -> np.ndarray:
    """(terms, axes) of all monomials up to a total degree."""
    terms = [chosen for total in range(degree + 1) for chosen in combinations_with_replacement(range(axes), total)]
    return np.array([[chosen.count(i) for i in range(axes)] for chosen in terms]).reshape(len(terms), axes)
