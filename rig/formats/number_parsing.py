"""A number as people and programs write it: decimal digits, a point, an exponent. Python takes more (1_0, nan, other
scripts' digits, spaces).
"""

import math
import re
from collections.abc import Iterable

LONGEST_NUMBER = 100  # characters; a float has 17 digits
UNBOUNDED = ("nan", "inf", "infinity")  # as programs write what is no finite number
_LETTERS = re.compile(r"[-+.0-9eE]+")  # of which float() takes nothing but numbers
_WHOLE = re.compile(r"[-+]?[0-9]+")


class NotFinite(ValueError):
    """A text that is no finite number, in words or by its size."""


def parse_number(text: str) -> float:
    """The finite number that a text is. Raises NotFinite, ValueError for anything else, spaces around it included."""
    if text.lower().lstrip("+-") in UNBOUNDED:
        raise NotFinite(f"not finite: {text!r}")
    if len(text) > LONGEST_NUMBER or not _LETTERS.fullmatch(text):
        raise ValueError(f"not a number: {text[:LONGEST_NUMBER]!r}")
    value = float(text)
    if not math.isfinite(value):
        raise NotFinite(f"not finite: {text!r}")
    return value


def parse_whole_number(text: str) -> int:
    """The whole number that a text is. Raises ValueError for anything else, spaces around it included."""
    if len(text) > LONGEST_NUMBER or not _WHOLE.fullmatch(text):
        raise ValueError(f"not a whole number: {text[:LONGEST_NUMBER]!r}")
    return int(text)


def parse_numbers(texts: Iterable[str]) -> list[float]:
    """The same of many. Raises ValueError where one is no finite number."""
    return [parse_number(text) for text in texts]
