"""Parsing and rounding of numbers.

Parsed strictly from text, and rounded to significant digits with a readable unit.

Python takes more (1_0, nan, other scripts' digits, spaces).
"""

import math
import re
from collections.abc import Iterable, Sequence

LONGEST_NUMBER = 100  # characters; a float has 17 digits
UNBOUNDED = ("nan", "inf", "infinity")  # as programs write no finite number
_LETTERS = re.compile(r"[-+.0-9eE]+")  # of which float() takes nothing but numbers
_WHOLE = re.compile(r"[-+]?[0-9]+")


class NotFinite(ValueError):
    """A text that is no finite number, in words or by its size."""


def parse_number(text: str) -> float:
    """Parse a finite number.

    Raises NotFinite, or ValueError for anything else, surrounding spaces included.
    """
    if text.lower().lstrip("+-") in UNBOUNDED:
        raise NotFinite(f"not finite: {text!r}")
    if len(text) > LONGEST_NUMBER or not _LETTERS.fullmatch(text):
        raise ValueError(f"not a number: {text[:LONGEST_NUMBER]!r}")
    value = float(text)
    if not math.isfinite(value):
        raise NotFinite(f"not finite: {text!r}")
    return value


def parse_whole_number(text: str) -> int:
    """Parse a whole number.

    Raises ValueError for anything else, surrounding spaces included.
    """
    if len(text) > LONGEST_NUMBER or not _WHOLE.fullmatch(text):
        raise ValueError(f"not a whole number: {text[:LONGEST_NUMBER]!r}")
    return int(text)


def parse_numbers(texts: Iterable[str]) -> list[float]:
    """Parse many finite numbers.

    Raises ValueError where one is no finite number.
    """
    return [parse_number(text) for text in texts]


MOST = 7  # digits by which two values may be told apart
PLAIN = 1e6  # from which a power of ten is the shorter
UNITS = {
    "m": ((1e6, "µm"), (1e3, "mm"), (1.0, "m")),
    "rad": ((1e6, "µrad"), (1e3, "mrad"), (1.0, "rad")),
    "m, rad": ((1e6, "µm, µrad"), (1e3, "mm, mrad"), (1.0, "m, rad")),
    "s": ((1e6, "µs"), (1e3, "ms"), (1.0, "s")),
    "N/m": ((1e-6, "N/µm"),),
    "N m/rad": ((1.0, "N m/rad"), (1e-3, "kN m/rad"), (1e-6, "MN m/rad")),
    "1": ((1.0, ""),),
    "1/K": ((1e6, "ppm/K"),),
}  # as people read them: the first in which a value is below 1000, or the last


def number_text(value: float, digits: int = 3) -> str:
    """Text of a number rounded to significant digits.

    Above 10^digits to the last digit before the point.

    >>> number_text(1139.6), number_text(0.0123456), number_text(-0.5)
    ('1140', '0.0123', '-0.5')
    """
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < PLAIN else text


def separating_digits(low: float, high: float, digits: int = 3) -> int:
    """Number of significant digits, `digits` at least, at which low and high differ.

    >>> separating_digits(199.81, 200.3), separating_digits(1.0, 2.0)
    (4, 3)
    """
    return next((n for n in range(digits, MOST) if number_text(low, n) != number_text(high, n)), digits)


def quantity_text(values: float | Sequence[float], unit: str) -> str:
    """Text of a quantity in an SI unit, or several, in the readable unit of the largest.

    >>> quantity_text(2078.46, "s"), quantity_text(4.2e-5, "m"), quantity_text(3, "")
    ('2080 s', '42 µm', '3')
    >>> quantity_text((0.001, -0.0005), "rad")
    '1 -0.5 mrad'
    """
    numbers = values if isinstance(values, Sequence) else (values,)
    scale, name = _read(max(map(abs, numbers)), unit)
    return f"{' '.join(number_text(v * scale) for v in numbers)} {name}".strip()


def range_text(low: float, high: float, unit: str) -> str:
    """Text of a range from low to high in SI units, in readable units.

    High may be infinite.

    >>> range_text(5e-6, 2e-4, "m"), range_text(1e-3, 60, "s"), range_text(0, 0.05, "m")
    ('5 to 200 µm', '1 ms to 60 s', '0 to 50 mm')
    >>> range_text(1e4, float("inf"), "N/m")
    '0.01 N/µm and more'
    """
    if ", " in unit:
        return ", ".join(range_text(low, high, one) for one in unit.split(", "))
    if math.isinf(high):
        return f"{quantity_text(low, unit)} and more"
    first, last = (_read(abs(end or other), unit) for end, other in ((low, high), (high, low)))
    left = number_text(low * first[0]) if first == last else quantity_text(low, unit)
    return f"{left} to {number_text(high * last[0])} {last[1]}".strip()


def _read(size: float, unit: str) -> tuple[float, str]:
    """(what a size is multiplied by, the unit's name) as people read it."""
    units = UNITS.get(unit, ((1.0, unit),))
    return next((pair for pair in units if size * pair[0] < 1000), units[-1])
