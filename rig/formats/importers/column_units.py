"""Units that headers state, and those that figures are likely in: of lengths, of angles, from zero or from home."""

import re
from collections.abc import Sequence

import numpy as np

LENGTHS = {"m": 1.0, "mm": 1e3, "cm": 1e2, "um": 1e6, "in": 1 / 0.0254}  # per metre
ANGLES = {"rad": 1.0, "deg": 180 / np.pi, "mrad": 1e3}  # per radian
TIMES = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}  # per second
ALL = (*LENGTHS, *ANGLES, "steps")
OTHER = ("C", "K", "F", "kg", "g")
SAME = {
    "µm": "um",
    "μm": "um",
    "µs": "us",
    "μs": "us",
    "°": "deg",
    "degrees": "deg",
    "degree": "deg",
    "radians": "rad",
    "meter": "m",
    "metre": "m",
    "inch": "in",
    "inches": "in",
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "usec": "us",
    "counts": "steps",
    "step": "steps",
    "°c": "C",
    "degc": "C",
    "celsius": "C",
    "c": "C",
    "k": "K",
    "kelvin": "K",
    "°f": "F",
    "degf": "F",
    "fahrenheit": "F",
    "f": "F",
}
BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*)\s*[\])]\s*$")
TAIL = re.compile(r"^(.*\S)\s*[_/ ]\s*([^\s_/]+)$")
MOST_BEYOND = 0.1  # of its range that a command may lie beyond it
LEAST_TRAVEL = 0.02  # of its range that a strut moves in a recording


def split_header(header: str) -> tuple[str, str | None]:
    """(name, unit or None) of a header as `L1 [mm]`, `t (s)`, `l1_mm`, `x/m`."""
    found = BRACKETS.match(header)
    if found and found[1]:
        return found[1].strip(), parse_unit(found[2])
    found = TAIL.match(header)
    if (
        found
        and parse_unit(found[2]) is not None
        and not (len(found[2]) == 1 and found[2].upper() == found[2] and "temp" not in header.lower())
    ):
        return found[1].rstrip("_/ "), parse_unit(found[2])
    return header, None


def parse_unit(word: str) -> str | None:
    """The unit that a word means, or None."""
    word = word.strip()
    if word in (*ALL, *TIMES, *OTHER):
        return word
    return SAME.get(word.lower()) or (word.lower() if word.lower() in (*ALL, *TIMES) else None)


def fits_ranges(values: np.ndarray, ranges: np.ndarray) -> bool:
    """Whether values (n, axes) lie within ranges (axes, 2), or a tenth of these beyond."""
    low, high = np.asarray(ranges).T
    slack = MOST_BEYOND * (high - low)
    return bool(((values >= low - slack) & (values <= high + slack)).all())


def likely_length_units(
    values: np.ndarray, ranges: np.ndarray, home: np.ndarray, units: Sequence[str], relative: Sequence[str]
) -> list[tuple[str, str]]:
    """(unit, "zero" or "home") of all ways that bring lengths (n, axes) into their ranges (axes, 2) m. home : (axes,)
    m
    """
    return [
        (u, r)
        for u in units
        for r in relative
        if fits_ranges(values / LENGTHS[u] + (home if r == "home" else 0.0), ranges)
    ]


def is_likely_unit(values: np.ndarray, ranges: np.ndarray, unit: str, relative: str) -> bool:
    """Whether lengths (n, axes), read so, move by a share of their ranges (axes, 2) m that a recording has; from home
    they lie about zero.
    """
    travel = np.ptp(values)
    about_zero = values.min() <= MOST_BEYOND * travel and values.max() >= -MOST_BEYOND * travel
    return bool(
        travel / LENGTHS[unit] >= LEAST_TRAVEL * np.ptp(ranges, axis=1).max() and (relative == "zero" or about_zero)
    )


def likely_angle_units(values: np.ndarray, limits: np.ndarray, units: Sequence[str]) -> list[str]:
    """Units in which angles (n, axes) lie within their limits (axes, 2) rad."""
    return [u for u in units if fits_ranges(values / ANGLES[u], limits)]
