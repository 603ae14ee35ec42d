"""Length and angle units, and their conversion.

Those that the owner of a file states ("mm, deg"), converted to m and rad.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from rig.array_and_json_types import Floats

LENGTHS = {"m": 1.0, "mm": 1e3, "cm": 1e2, "um": 1e6, "in": 1 / 0.0254}  # per metre
ANGLES = {"rad": 1.0, "deg": 180 / np.pi, "mrad": 1e3}  # per radian
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


def stated_units(tree: Mapping[str, object]) -> LengthAndAngleUnits:
    """LengthAndAngleUnits that a table states by its key `units`, m and rad where it has none.

    Raises ValueError.
    """
    return parse_length_and_angle_units(str(tree.get("units", SI)))


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
