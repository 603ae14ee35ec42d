"""A sum of functions of one axis each, piecewise linear between knots, as controllers' tables per joint hold them, by
least squares.

How many knots an axis gets is what the samples bear out (Bayesian information criterion). Source: configuration-space
patent, [0137]; the on-line learning patent for Stewart platforms, [0011] to [0015], learns along one axis after the
other likewise
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calib.correct.interpolation.field import Known, merge_repeats
from calib.correct.interpolation.regression_fields import EMPTY, Regressed, most_likely_field

KNOTS = (2, 3, 5, 9, 17, 33)  # tried
SAMPLES = 2  # for each knot, at the least


@dataclass(frozen=True, slots=True, eq=False)
class Axes(Regressed):
    """knots : (axes, count), ascending along each axis; coefficients : (axes count, outputs), axis after axis; the rest
    as Regressed has it.
    """

    knots: np.ndarray
    coefficients: np.ndarray
    root: np.ndarray
    noise: np.ndarray
    misfit: np.ndarray
    kind: ClassVar[str] = "axes"
    exact: ClassVar[bool] = False

    @property
    def low(self) -> np.ndarray:  # type: ignore[override]
        """(axes,) first knots."""
        return self.knots[:, 0]

    @property
    def high(self) -> np.ndarray:  # type: ignore[override]
        """(axes,) last knots."""
        return self.knots[:, -1]

    @classmethod
    def fit(cls, known: Known) -> Self:
        """The sum of functions with as many knots as is likeliest, through samples anywhere; knots where samples lie
        equally dense.
        """
        each = merge_repeats(known)
        n, axes = each.configurations.shape
        counts = [count for count in KNOTS if count == KNOTS[0] or SAMPLES * axes * count <= n]
        return most_likely_field(
            (
                cls(
                    np.array([_knots(each.configurations[:, i], count, known.strokes[i]) for i in range(axes)]),
                    *[EMPTY] * 4,
                )
                for count in counts
            ),
            each,
        )

    def functions(self, x: np.ndarray) -> np.ndarray:
        out = np.zeros((len(x), *self.knots.shape))
        for i, (cell, t, _) in enumerate(self._cells(x)):
            out[np.arange(len(x)), i, cell], out[np.arange(len(x)), i, cell + 1] = 1 - t, t
        return out.reshape(len(x), -1)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        out = np.zeros((len(x), *self.knots.shape, x.shape[1]))
        for i, (cell, _, width) in enumerate(self._cells(x)):
            out[np.arange(len(x)), i, cell, i], out[np.arange(len(x)), i, cell + 1, i] = -1 / width, 1 / width
        return out.reshape(len(x), -1, x.shape[1])

    def _cells(self, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Per axis (cell (n,), place in it 0..1 (n,), its width (n,))."""
        out = []
        for i, knots in enumerate(self.knots):
            cell = np.clip(np.searchsorted(knots, x[:, i], side="right") - 1, 0, len(knots) - 2)
            width = np.diff(knots)[cell]
            out.append((cell, (x[:, i] - knots[cell]) / width, width))
        return out


def _knots(values: np.ndarray, count: int, stroke: np.ndarray) -> np.ndarray:
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
