"""Parsing of option values: lengths, tolerances, numbers, shares."""

from __future__ import annotations

import math
import re
from argparse import ArgumentTypeError
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number

if TYPE_CHECKING:
    pass


def parse_length(text: str) -> float:
    """Parse a length with its unit, such as 20um, 0.02mm or 2e-5m, in m.

    Raises ArgumentTypeError for anything else.
    """
    for unit, scale in (("um", 1e-6), ("mm", 1e-3), ("m", 1.0)):
        if text.endswith(unit):
            try:
                value = parse_number(text.removesuffix(unit)) * scale
            except ValueError:
                break
            if 0 < value < float("inf"):
                return value
            break
    raise ArgumentTypeError(f"expected a length above 0 with its unit, 20um, 0.02mm or 2e-5m, not {text!r}")


TOLERANCE_UNITS = {
    "um": ("position", 1e-6),
    "mm": ("position", 1e-3),
    "m": ("position", 1.0),
    "urad": ("rotation", 1e-6),
    "arcsec": ("rotation", math.pi / 648000),
    "mrad": ("rotation", 1e-3),
    "rad": ("rotation", 1.0),
}


def parse_tolerance(text: str) -> tuple[str, float]:
    """Parse a tolerance such as 20um or 0.1mrad.

    Returns ("position", m) or ("rotation", rad)
    Raises ArgumentTypeError
    """
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]+)\s*", text)
    if found is None or found[2] not in TOLERANCE_UNITS or not 0 < float(found[1]) < 1e9:
        units = ", ".join(TOLERANCE_UNITS)
        raise ArgumentTypeError(f"{text!r} is not a tolerance; write a number > 0 and {units}, as in 20um")
    kind, scale = TOLERANCE_UNITS[found[2]]
    return kind, float(found[1]) * scale


def length_and_angle(texts: Sequence[str]) -> tuple[float, float]:
    """Tolerances (m, rad) of an option that takes a length and an angle.

    50um 0.2mrad, or two figures in m and rad.

    Raises RigError for anything else
    """
    try:
        plain = [parse_number(text) for text in texts]
    except ValueError:
        try:
            found = dict(parse_tolerance(text) for text in texts)
        except ArgumentTypeError as error:
            raise RigError(f"--tolerance: {error}") from None
        if len(found) != 2:
            raise RigError(f"--tolerance takes a length and an angle, as 50um 0.2mrad, not {' '.join(texts)}") from None
        return found["position"], found["rotation"]
    if len(plain) != 2 or not all(0 < value < float("inf") for value in plain):
        raise RigError(f"--tolerance takes a length and an angle, as 50um 0.2mrad, not {' '.join(texts)}")
    return plain[0], plain[1]


def parse_numbers(texts: list[str], count: int, option: str) -> list[float]:
    """Parse `count` numbers of an option, separated by commas or spaces.

    Raises RigError for anything else
    """
    try:
        found = [parse_number(word) for word in re.split(r"[,\s]+", " ".join(texts).strip(", "))]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(value) < 1e6 for value in found):
        raise RigError(f"{option} takes {count} numbers, separated by commas or spaces, not {' '.join(texts)!r}")
    return found


def require_share(speed: float) -> float:
    """Require a share of the greatest speed to lie within (0, 1].

    Raises RigError for anything else
    """
    if not 0 < speed <= 1:
        raise RigError(f"--speed takes a share above 0 and up to 1, got {speed:g}")
    return speed
