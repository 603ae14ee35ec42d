"""Units and timestamps of foreign tables.

Of columns; an error lists all readings where they are ambiguous.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import DIGITS
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.numbers_and_units import ANGLES, LENGTHS


class UnclearInput(RigError):
    """What a foreign file leaves open. settings : "KEY=VALUE" that likely decide it; is_decided : whether these are
    all that it needs, so that the rest can be read on that supposition
    """

    def __init__(self, message: str, settings: tuple[str, ...] = (), is_decided: bool = False) -> None:
        super().__init__(message)
        self.settings, self.is_decided = settings, is_decided


def ambiguity_error(subject: str, readings: Iterable[tuple[str, str]]) -> RigError:
    """Error about an ambiguous input that lists its possible readings.

    Each with the setting that selects it.
    readings : (what it would mean, "key=value" that decides for it)
    """
    return RigError("\n".join([f"{subject}:", *(f"  {reading}: --set '{setting}'" for reading, setting in readings)]))


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


def header_name_and_unit(header: str) -> tuple[str, str | None]:
    """Header split into (name, unit or None).

    `L1 [mm]`, `t (s)`, `l1_mm`, `x/m`.
    """
    found = BRACKETS.match(header)
    if found and found[1]:
        return found[1].strip(), known_unit_of_word(found[2])
    found = TAIL.match(header)
    if (
        found
        and known_unit_of_word(found[2]) is not None
        and not (len(found[2]) == 1 and found[2].upper() == found[2] and "temp" not in header.lower())
    ):
        return found[1].rstrip("_/ "), known_unit_of_word(found[2])
    return header, None


def unrecognised_unit_of_header(header: str) -> str | None:
    """Unrecognised unit in brackets at the end of a header, None where there is none."""
    found = BRACKETS.match(header)
    return found[2] if found and found[1] and known_unit_of_word(found[2]) is None else None


def known_unit_of_word(word: str) -> str | None:
    """The known unit that a word means, or None."""
    word = word.strip()
    if word in (*ALL, *TIMES, *OTHER):
        return word
    return SAME.get(word.lower()) or (word.lower() if word.lower() in (*ALL, *TIMES) else None)


def fits_ranges_within_a_tenth(values: Floats, ranges: Floats) -> bool:
    """Whether values (n, axes) fit the ranges (axes, 2), with a tolerance of a tenth."""
    low, high = np.asarray(ranges).T
    slack = MOST_BEYOND * (high - low)
    return bool(((values >= low - slack) & (values <= high + slack)).all())


def likely_length_units_and_zeros(
    values: Floats, ranges: Floats, home_lengths: Floats, units: Sequence[str], zeros: Sequence[str]
) -> list[tuple[str, str]]:
    """Likely units and zeros (unit, "zero" or "home") of lengths.

    Those that bring lengths (n, axes) into their ranges (axes, 2) m.
    home_lengths : (axes,) m
    """
    return [
        (u, r)
        for u in units
        for r in zeros
        if fits_ranges_within_a_tenth(values / LENGTHS[u] + (home_lengths if r == "home" else 0.0), ranges)
    ]


def is_likely_length_unit(values: Floats, ranges: Floats, unit: str, zero: str) -> bool:
    """Whether a unit is likely for lengths (n, axes).

    They travel a plausible share of their ranges (axes, 2) m.
    """
    travel = np.ptp(values)
    about_zero = values.min() <= MOST_BEYOND * travel and values.max() >= -MOST_BEYOND * travel
    return bool(
        travel / LENGTHS[unit] >= LEAST_TRAVEL * np.ptp(ranges, axis=1).max() and (zero == "zero" or about_zero)
    )


ISO = re.compile(r"(\d{4}-?\d\d-?\d\d[T _]\d\d:?\d\d(?::?\d\d)?)([.,]\d{1,18})?\s*(Z|z|[+-]\d\d:?\d\d)?")
SECONDS = re.compile(r"[+-]?\d{1,30}(\.\d{0,30})?([eE][+-]?\d{1,2})?")
ZONE = re.compile(r"([+-])(\d\d):?(\d\d)|Z|UTC")
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
SINCE, UNTIL = 946684800, 4102444800  # s; 2000 and 2100: what lies between counts from 1970
NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "iso": "ISO 8601"}


@dataclass(frozen=True, slots=True)
class Times:
    """seconds : exact; unit : one of s, ms, us, ns, iso; zone : of ISO times that state none, or None;
    remarks : sentences.
    """

    seconds: list[Decimal]
    unit: str
    zone: str | None
    remarks: tuple[str, ...]


def index_of_first_unreadable_time(texts: Sequence[str], unit: str | None) -> int | None:
    """Index of the first text that is no time, or None.

    No number, or no ISO 8601 where most are or `unit` is "iso".
    """
    form = max((SECONDS, ISO), key=lambda one: sum(map(bool, map(one.fullmatch, texts))))
    form = form if unit is None else ISO if unit == "iso" else SECONDS
    return next((k for k, text in enumerate(texts) if not form.fullmatch(text)), None)


def read_times(
    cells: list[str],
    section: str,
    subject: str,
    unit: str | None,
    time_zone: str | None,
    shift: float,
    are_plausible: Callable[[Floats], bool] = lambda t: True,
) -> Times:
    """Read times from text cells.

    In s, ms, us, ns, since 1970 or a start, or as ISO 8601.
    section : of the section, as settings call it; subject : is read, in words; unit : stated, or None; shift : s added

    are_plausible : whether (n,) s from the first can be so
    Raises RigError for texts that are no times, and where several units can be meant
    """
    numeric = all(map(SECONDS.fullmatch, cells))
    by = Decimal(repr(float(shift)))
    if unit == "iso" or (unit is None and not numeric):
        return _iso(cells, section, subject, time_zone, by, () if unit else (f"{subject}: times are ISO 8601",))
    if not numeric:
        bad = next(cell for cell in cells if not SECONDS.fullmatch(cell))
        raise RigError(f"{subject}: {short_repr(bad)} is not a time in {NAMES[unit or 's']}")
    values = [Decimal(cell) for cell in cells]
    found, message = _unit(values, section, subject, are_plausible) if unit is None else (unit, ())
    return Times([DIGITS.add(DIGITS.divide(value, TIMES[found]), by) for value in values], found, None, message)


def _unit(
    values: list[Decimal], name: str, what: str, plausible: Callable[[Floats], bool]
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


def _iso(cells: list[str], name: str, what: str, zone: str | None, by: Decimal, remarks: tuple[str, ...]) -> Times:
    read = [ISO.fullmatch(cell) for cell in cells]
    found = [one for one in read if one is not None]
    if len(found) < len(cells):
        bad = next(cell for cell, one in zip(cells, read) if one is None)
        raise RigError(
            f"{what}: {short_repr(bad)} is not a time: times are numbers, or ISO 8601 as 2026-01-31T12:00:00.25Z"
        )
    zones = {one[3] is None for one in found}
    if len(zones) > 1:
        raise RigError(f"{what}: some times state a time zone and some do not")
    if zones == {True} and zone is None:
        zone, remarks = (
            "UTC",
            (*remarks, f"{what}: times state no time zone and are read as UTC (--set {name}.zone=+01:00 changes it)"),
        )
    seconds = [_seconds(one, zone, what) for one in found]
    return Times([DIGITS.add(t, by) for t in seconds], "iso", zone if zones == {True} else None, remarks)


def _seconds(found: re.Match[str], zone: str | None, what: str) -> Decimal:
    try:
        at = datetime.fromisoformat(found[1].replace("_", "T"))
        at = at.replace(tzinfo=_zone(found[3] or zone or "UTC"))
        whole = at - EPOCH
    except (ValueError, OverflowError) as error:
        raise RigError(f"{what}: {short_repr(found[0])} is not a time: {error}") from None
    return Decimal(whole.days * 86400 + whole.seconds) + Decimal((found[2] or ".0").replace(",", "."))


def _zone(word: str) -> timezone:
    found = ZONE.fullmatch(word.upper())
    if found is None:
        raise RigError(f"a time zone is +01:00, -05:00 or UTC, not {short_repr(word)}")
    if found[1] is None:
        return UTC
    away = timedelta(hours=int(found[2]), minutes=int(found[3]))
    return timezone(-away if found[1] == "-" else away)
