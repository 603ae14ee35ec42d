"""How values become places on a figure: linear or logarithmic, with ticks."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rig.report.pages.svg_elements import round_ticks

ROOM = 0.05  # of the range, on either side of the values


@dataclass(frozen=True)
class Scale:
    """Values low .. high at places start .. end of a figure; log : by their logarithm; whole : of whole numbers, as
    frames are.
    """

    low: float
    high: float
    start: float
    end: float
    log: bool = False
    whole: bool = False

    def at(self, values: np.ndarray | float) -> np.ndarray:
        """Places of values, any shape."""
        v = np.asarray(values, float)
        low, high = self.low, self.high
        if self.log:
            with np.errstate(divide="ignore"):
                v = np.log10(np.maximum(v, 0))
            low, high = math.log10(low), math.log10(high)
        return self.start + (self.end - self.start) * (v - low) / (high - low)

    @cached_property
    def ticks(self) -> list[float]:
        """Values at which ticks stand."""
        if not self.log:
            return [v for v in round_ticks(self.low, self.high) if v == round(v) or not self.whole]
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        wide = last - first > 2
        every = -(-(last - first) // 6)
        found = [
            k * 10.0**p
            for p in range(first, last + 1)
            if (p - first) % every == 0
            for k in ((1,) if wide else (1, 2, 5))
        ]
        return [v for v in found if self.low <= v * (1 + 1e-9) and v <= self.high * (1 + 1e-9)]

    def said(self) -> str:
        """For the page's script: low, high, start, end, and log where it is."""
        return f"{self.low:.6g} {self.high:.6g} {self.start:.1f} {self.end:.1f}" + (" log" if self.log else "")


def scale_of_values(
    values: np.ndarray,
    ends: tuple[float, float],
    log: bool = False,
    limits: tuple[float, float] | None = None,
    whole: bool = False,
) -> Scale:
    """Scale that holds all finite values (n,), positive ones where it is logarithmic. ends : (2,) places; limits : in
    place of the values' own
    whole : whether they are whole numbers"""
    known = np.asarray(values, float).ravel()
    known = known[np.isfinite(known) & ((known > 0) | (not log))]
    if limits is not None:
        low, high = limits
    elif not len(known):
        low, high = (0.1, 1.0) if log else (0.0, 1.0)
    else:
        low, high = float(known.min()), float(known.max())
        if log:
            low, high = low / 1.3, high * 1.3
        else:
            room = ROOM * (high - low) or 0.5 * abs(high) or 1.0
            low, high = low - room, high + room
    return Scale(low, high, *ends, log, whole)
