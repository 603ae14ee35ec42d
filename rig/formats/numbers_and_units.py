"""Numbers and units: parsed, rounded, converted.

Numbers are parsed strictly from text (Python takes more: 1_0, nan, other scripts' digits, spaces), and rounded to
significant digits with a readable unit. Units that the owner of a file states ("mm, deg") are converted to m and rad.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.array_and_json_types import Floats

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
    texts = list(texts)
    if not texts:
        return []
    if _LETTERS.fullmatch("".join(texts)) and max(map(len, texts)) <= LONGEST_NUMBER:
        values = list(map(float, texts))  # a fifth of the time of one by one
        if all(map(math.isfinite, values)):
            return values
    return [parse_number(text) for text in texts]


SUFFIXES = {
    "m": {"um": 1e6, "mm": 1e3, "m": 1.0},
    "rad": {"urad": 1e6, "arcsec": 648000 / math.pi, "mrad": 1e3, "deg": 180 / math.pi, "rad": 1.0},
    "m/s": {"um/s": 1e6, "mm/s": 1e3, "m/s": 1.0},
}  # {SI unit: {unit after a number: how many make an SI unit}}; to divide by them rounds once
_QUANTITY = re.compile(r"(.*?[0-9.])([a-zµμ]+(?:/s)?)?")


def parse_quantity(text: str, unit: str, plain: float = 1.0) -> float:
    """Parse a quantity, in an SI unit.

    A finite number, with a unit of SUFFIXES after it or without.
    plain : how many of the unit of a number without one make an SI unit
    Raises ValueError for anything else

    >>> parse_quantity("-0.5mm", "m"), parse_quantity("3", "m/s", 1e3), parse_quantity("3mm/s", "m/s")
    (-0.0005, 0.003, 0.003)
    """
    found = _QUANTITY.fullmatch(text)
    if found is None or found[2] is None:
        return parse_number(text) / plain
    scale = SUFFIXES.get(unit, {}).get(found[2].replace("µ", "u").replace("μ", "u"))
    if scale is None:
        raise ValueError(f"no unit of {unit}: {found[2][:LONGEST_NUMBER]!r}")
    return parse_number(found[1]) / scale


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


def count_text(count: int, noun: str, plural: str = "") -> str:
    """Text of a count with its noun in the singular or plural.

    And with what follows the noun.
    plural : by default the noun with an s

    >>> count_text(1, "frame"), count_text(0, "frame"), count_text(2, "frame has no pose", "frames have no pose")
    ('1 frame', '0 frames', '2 frames have no pose')
    """
    return f"{count} {noun if count == 1 else plural or f'{noun}s'}"


def digits_that_distinguish_numbers(low: float, high: float, digits: int = 3) -> int:
    """Number of significant digits at which two numbers differ.

    At least `digits`.
    >>> digits_that_distinguish_numbers(199.81, 200.3), digits_that_distinguish_numbers(1.0, 2.0)
    (4, 3)
    """
    return next((n for n in range(digits, MOST) if number_text(low, n) != number_text(high, n)), digits)


def quantity_text(values: float | Sequence[float], unit: str) -> str:
    """Text of a quantity in a readable unit.

    One number in an SI unit, or several; the unit is that of the largest.

    >>> quantity_text(2078.46, "s"), quantity_text(4.2e-5, "m"), quantity_text(3, "")
    ('2080 s', '42 µm', '3')
    >>> quantity_text((0.001, -0.0005), "rad")
    '1 -0.5 mrad'
    """
    numbers = values if isinstance(values, Sequence) else (values,)
    scale, name = _read(max(map(abs, numbers)), unit)
    return f"{' '.join(number_text(v * scale) for v in numbers)} {name}".strip()


def range_text(low: float, high: float, unit: str) -> str:
    """Text of a range from low to high in readable units.

    Low and high are in SI units.
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


LENGTHS = {"m": 1.0, "mm": 1e3, "cm": 1e2, "um": 1e6, "in": 1 / 0.0254}  # per metre
ANGLES = {"rad": 1.0, "deg": 180 / math.pi, "mrad": 1e3}  # per radian
DYNAMIC = {"N", "kg"}  # a unit with one of these is a force's, torque's, mass's or inertia's, and stays as it is
OTHER = {"", "s", "K", "A", "px", "dB", "rev", "grey levels"}  # that hold no length and no angle
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^([0-9]))?")
UnitNames = str | Sequence["UnitNames"]  # a unit, or one for each number of an array, nested as it broadcasts


@dataclass(frozen=True, slots=True)
class LengthAndAngleUnits:
    """Units of the lengths and angles of a file. length : of LENGTHS; angle : of ANGLES"""

    length: str = "m"
    angle: str = "rad"

    def __str__(self) -> str:
        return f"{self.length}, {self.angle}"

    def per_si(self, unit: str) -> float:
        """What a figure in an SI unit, as "m", "rad/s" or "m/s^2", is multiplied by to be in these units.

        Units with a force or mass stay: N m, kg m^2. Raises ValueError for a unit that is not known.
        """
        return _per_si(unit.split(" (")[0], self.length, self.angle)

    def name(self, unit: str) -> str:
        """Name of an SI unit in these units: "mm/s" for "m/s"."""
        plain, remark = unit.split(" (")[0], unit.partition(" (")[2]
        if self.per_si(plain) != 1:
            plain = re.sub(r"\bm\b", self.length, re.sub(r"\brad\b", self.angle, plain))
        return plain + (f" ({remark}" if remark else "")

    def shown(self, value: float, unit: str) -> str:
        """A value in an SI unit as text in these units, with its unit."""
        return f"{value * self.per_si(unit):.10g} {self.name(unit)}".rstrip()

    def si(self, values: Floats | float, unit: UnitNames) -> Floats:
        """Values in these units, in SI. unit : one SI unit, or several that broadcast over the values"""
        import numpy as np  # only here: `rig stop` reads numbers too, and waits for nothing

        if self == SI:
            return np.asarray(values, float)
        return np.asarray(values, float) / np.vectorize(self.per_si, otypes=[float])(np.array(unit))


SI = LengthAndAngleUnits()


def parse_length_and_angle_units(text: str) -> LengthAndAngleUnits:
    """LengthAndAngleUnits of a text such as "mm, deg".

    >>> str(parse_length_and_angle_units("deg, mm"))
    'mm, deg'

    Raises ValueError unless it is one of each, in any order.
    """
    words = [word.strip() for word in text.split(",")]
    lengths, angles = ([word for word in words if word in known] for known in (LENGTHS, ANGLES))
    if len(lengths) != 1 or len(angles) != 1 or len(words) != 2:
        raise ValueError(
            f'a unit of lengths ({", ".join(LENGTHS)}) and one of angles ({", ".join(ANGLES)}), as "mm, deg", '
            f"not {text[:64]!r}"
        )
    return LengthAndAngleUnits(*lengths, *angles)


def stated_units(table: Mapping[str, object]) -> LengthAndAngleUnits:
    """LengthAndAngleUnits that a table states.

    By its key `units`; m and rad where it has none.
    Raises ValueError.
    """
    return parse_length_and_angle_units(str(table.get("units", SI)))


@cache
def _per_si(unit: str, length: str, angle: str) -> float:
    if unit in OTHER:
        return 1.0
    above, *below = unit.split("/")
    out, parts = 1.0, []
    for text, sign in [(above, 1), *((one, -1) for one in below)]:
        for word in text.split(" "):
            found = _FACTOR.fullmatch(word)
            if found is None:
                raise ValueError(f"unit {unit!r} is not known")
            parts.append(found[1])
            out *= {"m": LENGTHS[length], "rad": ANGLES[angle]}.get(found[1], 1.0) ** (sign * int(found[2] or 1))
    if DYNAMIC & set(parts):
        return 1.0
    if set(parts) - OTHER - {"m", "rad", "1"}:
        raise ValueError(f"unit {unit!r} is not known")
    return out
