"""Units in which axes are shown and in which controllers count.

mm of struts and slides, degrees of joints.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_quantity
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism

SHOWN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}  # {unit: (how many make one, name)}

MM_AND_DEGREES = {unit: scale for unit, (scale, _) in SHOWN.items()}  # {unit: how many make one}


def parse_axis_values(option: str, texts: Sequence[str], units: Sequence[str], plain: Mapping[str, float]) -> Floats:
    """Parse the values (axes,) m or rad of an option, one text for each axis.

    units : "m" or "rad" of the axes; plain : {unit: how many make one} of numbers without a unit
    Raises RigError for another number of texts, and for what is no length or angle.
    """
    try:
        values = np.array([parse_quantity(text, unit, plain[unit]) for text, unit in zip(texts, units)])
    except ValueError as error:
        wanted = "lengths (um, mm, m) of struts and slides, angles (mrad, deg, rad) of joints"
        raise RigError(f"{option} takes {wanted}: {error}") from None
    if len(texts) != len(units) or not np.isfinite(values).all():
        raise RigError(f"{option} takes {len(units)} values separated by commas, got {','.join(texts)!r}")
    return values


def controller_counts_per_metre_or_radian(units: Sequence[str], per_metre: float = 1e3) -> Floats:
    """Counts (n,) of a controller per m or rad of each axis.

    Of joints it counts degrees.
    units : "m" or "rad" of each; per_metre : of the others, by default mm
    """
    return np.array([SHOWN["rad"][0] if unit == "rad" else per_metre for unit in units])


def value_text(value: float, unit: str, digits: int = 3) -> str:
    """Text of a value in m or rad with its unit.

    In mm or degrees.
    """
    scale, name = SHOWN[unit]
    return f"{value * scale:.{digits}f} {name}"


def axis_values_text(values: Floats, mechanism: Mechanism, digits: int = 4) -> str:
    """Text of axis values (axes,) m or rad.

    In mm or degrees, the unit last where all have one.
    """
    units = mechanisms.axis_units(mechanism)
    texts = [value_text(float(value), unit, digits) for value, unit in zip(values, units)]
    if len(set(units)) > 1:
        return ", ".join(texts)
    return " ".join(text.partition(" ")[0] for text in texts) + f" {SHOWN[units[0]][1]}"


def greatest_distance_text(difference: Floats, mechanism: Mechanism, digits: int = 3) -> str:
    """Text of the greatest of the axes' distances (axes,) m or rad.

    Of slides and joints each.
    """
    units, sizes = mechanisms.axis_units(mechanism), np.abs(difference)
    return " and ".join(
        value_text(max(float(size) for size, one in zip(sizes, units) if one == unit), unit, digits)
        for unit in dict.fromkeys(units)
    )


def axis_milliunit_name(mechanism: Mechanism) -> str:
    """Name of a thousandth of the axes' units: mm, mrad, or both."""
    return " or ".join(f"m{unit}" for unit in dict.fromkeys(mechanisms.axis_units(mechanism)))


def axes_word(mechanism: Mechanism) -> str:
    """Word for the axes of a mechanism together: struts, joints, slides, or axes where they differ."""
    words = set(mechanism.axis_words)
    return f"{words.pop()}s" if len(words) == 1 else "axes"
