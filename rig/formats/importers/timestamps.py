"""Foreign times -> exact seconds: since 1970 or from a start, in s, ms, us, ns or as ISO 8601."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal

import numpy as np

from rig.errors import RigError
from rig.formats.importers.ambiguous_input import ambiguity_error
from rig.formats.importers.column_units import TIMES
from rig.formats.input_files import value_text
from rig.recording.time_origin import DIGITS

ISO = re.compile(r"(\d{4}-?\d\d-?\d\d[T _]\d\d:?\d\d(?::?\d\d)?)([.,]\d{1,18})?\s*(Z|z|[+-]\d\d:?\d\d)?")
ZONE = re.compile(r"([+-])(\d\d):?(\d\d)|Z|UTC")
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
SINCE, UNTIL = 946684800, 4102444800  # s; 2000 and 2100: what lies between counts from 1970
NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "iso": "ISO 8601"}


@dataclass(frozen=True, slots=True)
class Times:
    """seconds : exact; unit : one of s, ms, us, ns, iso; zone : of ISO times that state none, or None;
    said : sentences.
    """

    seconds: list[Decimal]
    unit: str
    zone: str | None
    said: tuple[str, ...]

    def floats(self) -> np.ndarray:
        """(n,) s from the first."""
        return np.array([float(DIGITS.subtract(t, self.seconds[0])) for t in self.seconds])


def read_times(
    cells: list[str],
    name: str,
    what: str,
    unit: str | None,
    zone: str | None,
    shift: float,
    plausible: Callable[[np.ndarray], bool] = lambda t: True,
) -> Times:
    """Times of texts. name : of the section, as settings call it; what : is read, in words; unit : stated, or None;
    shift : s added

    plausible : whether (n,) s from the first can be so
    Raises RigError for texts that are no times, and where several units can be meant
    """
    numeric = all(re.fullmatch(r"[+-]?\d{1,30}(\.\d{0,30})?([eE][+-]?\d{1,2})?", cell) for cell in cells)
    by = Decimal(repr(float(shift)))
    if unit == "iso" or (unit is None and not numeric):
        return _iso(cells, name, what, zone, by, () if unit else (f"{what}: times are ISO 8601",))
    if not numeric:
        bad = next(cell for cell in cells if not re.fullmatch(r"[+-]?\d{1,30}(\.\d{0,30})?([eE][+-]?\d{1,2})?", cell))
        raise RigError(f"{what}: {value_text(bad)} is no time in {NAMES[unit or 's']}")
    values = [Decimal(cell) for cell in cells]
    found, said = _unit(values, name, what, plausible) if unit is None else (unit, ())
    return Times([DIGITS.add(DIGITS.divide(value, TIMES[found]), by) for value in values], found, None, said)


def _unit(
    values: list[Decimal], name: str, what: str, plausible: Callable[[np.ndarray], bool]
) -> tuple[str, tuple[str, ...]]:
    for unit, per_second in TIMES.items():
        if all(SINCE * per_second < value < UNTIL * per_second for value in values):
            return unit, (f"{what}: times are {NAMES[unit]} since 1970",)
    t = np.array([float(value - values[0]) for value in values])
    fit = [unit for unit in TIMES if plausible(t / TIMES[unit])]
    span = abs(t[-1])
    if len(fit) == 1 and span:
        return fit[0], (f"{what}: times are {NAMES[fit[0]]}, as in others speeds or spans could not be",)
    raise ambiguity_error(
        f"{what}: the unit of its times is not stated, and they run from {values[0]} to {values[-1]}",
        [(f"{span / TIMES[unit]:.4g} s in all", f"{name}.time_unit={unit}") for unit in fit or TIMES],
    )


def _iso(cells: list[str], name: str, what: str, zone: str | None, by: Decimal, said: tuple[str, ...]) -> Times:
    read = [ISO.fullmatch(cell) for cell in cells]
    found = [one for one in read if one is not None]
    if len(found) < len(cells):
        bad = next(cell for cell, one in zip(cells, read) if one is None)
        raise RigError(
            f"{what}: {value_text(bad)} is no time: times are numbers, or ISO 8601 as 2026-01-31T12:00:00.25Z"
        )
    zones = {one[3] is None for one in found}
    if len(zones) > 1:
        raise RigError(f"{what}: some times state a time zone and some do not")
    if zones == {True} and zone is None:
        zone, said = (
            "UTC",
            (*said, f"{what}: times state no time zone and are taken as UTC (--set {name}.zone=+01:00 says otherwise)"),
        )
    seconds = [_seconds(one, zone, what) for one in found]
    return Times([DIGITS.add(t, by) for t in seconds], "iso", zone if zones == {True} else None, said)


def _seconds(found: re.Match, zone: str | None, what: str) -> Decimal:
    try:
        at = datetime.fromisoformat(found[1].replace("_", "T"))
        at = at.replace(tzinfo=_zone(found[3] or zone or "UTC"))
        whole = at - EPOCH
    except (ValueError, OverflowError) as error:
        raise RigError(f"{what}: {value_text(found[0])} is no time: {error}") from None
    return Decimal(whole.days * 86400 + whole.seconds) + Decimal((found[2] or ".0").replace(",", "."))


def _zone(word: str) -> timezone:
    found = ZONE.fullmatch(word.upper())
    if found is None:
        raise RigError(f"a time zone is +01:00, -05:00 or UTC, not {value_text(word)}")
    if found[1] is None:
        return UTC
    away = timedelta(hours=int(found[2]), minutes=int(found[3]))
    return timezone(-away if found[1] == "-" else away)
