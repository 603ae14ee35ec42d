"""Values of a finding's parameters: a number or numbers, their unit and 95 % interval, as far as the data close it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.arrays import Floats
from rig.recording.time_origin import Origin

# value, low, high of a number, or of the numbers of a vector
Interval = tuple[float, float, float] | tuple[list[float], list[float], list[float]]


@dataclass(frozen=True, slots=True)
class Value:
    """value : number, list of numbers or names; unit; ci95 : (low, high) of a number, (lows, highs) of a list;
    at_bound : the bound of what makes sense that the value stands at, the data asking for more; open : "below", "above"
        or
    "both" where the data leave it open up to a bound of what makes sense, at which ci95 ends"""

    value: Any
    unit: str
    ci95: list[Any] | None = None
    at_bound: float | None = None
    open: str | None = None


def bounded_value(
    value: float, unit: str, ends: tuple[float, float], bounds: tuple[float, float], at_bound: float | None = None
) -> Value:
    """Value of a number whose 95 % interval ends where what makes sense does."""
    low, high = max(ends[0], bounds[0]), min(ends[1], bounds[1])
    below, above = low == bounds[0], high == bounds[1]
    return Value(
        value,
        unit,
        [low, high],
        at_bound,
        "both" if below and above else "below" if below else "above" if above else None,
    )


def moment_value(t: Floats, value: float, origin: Origin, likely: tuple[float, float] | None = None) -> Value:
    """A moment (s from the recording's start) by the owner's clock, and the frames, at t (n,) s, between which it lies.

    likely : (earliest, latest) s, where it may lie between other frames as well
    """
    low, high = (np.clip(np.searchsorted(t, v), 1, len(t) - 1) for v in likely or (value, value))
    return Value(origin.shown(value), "s", [origin.shown(t[low - 1]), origin.shown(t[high])])
