"""Time origin of a recording: the owner's clock to seconds from the start, and back, without rounding.

A clock that counts from 1970 stands at 1.7e9 s, where a float resolves 2.4e-7 s; the start is therefore taken off in
decimal, before a time becomes a float, and put back in decimal when one is written.
"""

from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation

import numpy as np

from rig.array_and_json_types import Floats

DIGITS = Context(prec=60, traps=[])
LATEST = 1e11  # s, in the year 5138; a greater figure is in another unit
UNITS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))


@dataclass(frozen=True, slots=True)
class TimeOrigin:
    """offset : s, what the owner's clock shows at the recording's start, t = 0."""

    offset: Decimal = Decimal(0)

    def seconds(self, texts: list[str]) -> Floats:
        """(n,) s from the recording's start, of n times as the owner's clock shows them: texts that are finite
        numbers.
        """
        if not self.offset:
            return np.array(texts, float)
        return np.array([float(DIGITS.subtract(parse_exact_decimal(text), self.offset)) for text in texts], float)

    def text(self, t: float) -> str:
        """A time t (s from the recording's start) as the owner's clock shows it, with all the digits that it had."""
        return f"{DIGITS.add(self.offset, Decimal(repr(float(t)))):f}"

    def shown(self, t: float) -> float:
        """The same as a number."""
        return float(self.text(t)) if self.offset else float(t)


def parse_exact_decimal(text: str) -> Decimal:
    """Exact Decimal of a finite number's text."""
    try:
        return Decimal(text)
    except InvalidOperation:  # an exponent beyond what decimals hold: nothing, as for a float
        return Decimal(float(text))


def likely_time_unit(t: float) -> str:
    """Likely unit, as text, of a time that is too large for seconds."""
    return next((name for name, scale in UNITS if abs(t) / scale < LATEST / 10), UNITS[-1][0])
