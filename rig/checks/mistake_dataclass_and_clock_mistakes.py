"""Mistake dataclass, and mistakes of clocks and times.

A mistake of a user as a data type, and the sorting of mistakes.

A Mistake says what is wrong in a recording or rig.toml and what to do; times may be in wrong units, repeated or apart,
or a shift lies between frames' and commands' clocks.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats


@dataclass(frozen=True, slots=True)
class Mistake:
    """what : a sentence that names it, with the file; do : what to do about it; spoils : whether results mean nothing
    until it is mended;
    proof : 0..1, how much of what is wrong it explains, 1 where nothing else can be the cause."""

    what: str
    do: str
    spoils: bool = True
    proof: float = 0.5

    def __str__(self) -> str:
        return f"{self.what}. {self.do}"


def sort_mistakes(mistakes: Iterable[Mistake]) -> tuple[Mistake, ...]:
    """Mistakes sorted by what they spoil and by likelihood, each once.

    Those that spoil results come first, of these the likeliest first.
    """
    return tuple(sorted(dict.fromkeys(mistakes), key=lambda one: (not one.spoils, -one.proof)))


UNITS = {
    "milliseconds": 1e3,
    "microseconds": 1e6,
    "nanoseconds": 1e9,
    "minutes": 1 / 60,
    "hours": 1 / 3600,
}  # per second
LIKE = 0.3  # share by which a ratio of spans may differ from a unit's
APART = 0.5  # share of the recording's span that must lie within the commands, for the clocks to be one
QUARTER = 900.0  # s; time zones differ by multiples of it
ZONE = 60.0  # s by which a difference of clocks may differ from a time zone's
FASTEST, SLOWEST = 3.0, 1 / 300  # of the stated top speed, that the fastest move of a recording may have
USUAL = {"m": (1e-4, 3.0), "rad": (2e-4, 30.0)}  # per s: fastest moves of machines that state no top speed
RATE = (1e-4, 5000.0)  # frames per s


def time_unit_and_clock_origin_mistakes(times_by_file: dict[str, Floats]) -> Iterator[Mistake]:
    """Mistakes of time units and clock origins.

    Files whose times (n,) s do not overlap those of the frames.

    A file whose span is a unit's multiple of the others' is in that unit; one that does not overlap has another origin.
    """
    ends = {name: (float(t.min()), float(t.max())) for name, t in times_by_file.items() if len(t) > 1 and np.ptp(t) > 0}
    if "frames.csv" not in ends:
        return
    start, end = ends["frames.csv"]
    odd = _odd_units(ends)
    for name, (unit, others) in odd.items():
        yield Mistake(
            f"{name}: times are in {unit}, while {' and '.join(others)} {'are' if len(others) > 1 else 'is'} "
            "in seconds",
            f"Divide t of {name} by {UNITS[unit]:g}"
            if UNITS[unit] > 1
            else f"Multiply t of {name} by {1 / UNITS[unit]:g}",
            proof=0.95,
        )
    for name, (low, high) in ends.items():
        if name == "frames.csv" or name in odd or "frames.csv" in odd:
            continue
        inside = max(0.0, min(high, end) - max(low, start)) / max(end - start, 1e-9)
        if inside < APART:
            shift = (
                (low - start)
                if abs((high - low) - (end - start)) < LIKE * (end - start)
                else (low + high - start - end) / 2
            )
            yield Mistake(
                f"{name} and frames.csv are on different clocks: frames run from {start:.10g} to {end:.10g} "
                f"s, {name} from {low:.10g} to "
                f"{high:.10g} s" + _zone(shift),
                f"Bring both to one clock: t of one of them is about {abs(shift):.10g} s off",
                proof=0.9,
                spoils=name == "commands.csv",
            )


def _odd_units(ends: dict[str, tuple[float, float]]) -> dict[str, tuple[str, list[str]]]:
    """{file: (unit, the files in seconds)} of files whose span is a unit's multiple of the others'."""
    spans = {name: high - low for name, (low, high) in ends.items()}
    found: dict[str, tuple[str, list[str]]] = {}
    for name, span in spans.items():
        others = [other for other in spans if other != name]
        if not others:
            continue
        for unit, per_second in UNITS.items():
            alike = [other for other in others if abs(span / spans[other] / per_second - 1) < LIKE]
            if len(alike) * 2 >= len(others) and alike and (len(others) > 1 or per_second > 1):
                found[name] = (unit, alike)
    if len(found) > 1:  # two files that differ: the longer span is in the finer unit
        longest = max(found, key=lambda name: (len(found[name][1]), spans[name]))
        return {longest: found[longest]}
    return found


def _zone(shift: float) -> str:
    if abs(shift) > 1e8:
        return "; one counts from 1970, the other from another time"
    whole = round(shift / QUARTER)
    if whole and abs(shift - whole * QUARTER) < ZONE and whole % 2 == 0:
        return f"; that is {abs(whole) * QUARTER / 3600:g} hours, as time zones differ"
    return ""


def implausible_axis_speed_and_frame_rate_mistakes(
    t: Floats, values: Floats, frames: Floats, unit: str, max_speed: float | None
) -> Iterator[Mistake]:
    """Mistakes of implausible axis speeds and frame rates.

    Axis speeds above any plausible maximum, or frame rates; then times are in another unit.
    t : (n,) s and values : (n, axes) m or rad of the commands; frames : (F,) s; unit : "m" or "rad"; max_speed : m/s
        stated, or None
    """
    step = np.abs(np.diff(values, axis=0)).max(axis=1) / np.maximum(np.diff(t), 1e-12) if len(t) > 1 else np.zeros(0)
    if len(step) and step.max() > 0:
        fastest = float(np.quantile(step[step > 0], 0.9))
        low, high = (SLOWEST * max_speed, FASTEST * max_speed) if max_speed else USUAL[unit]
        against = (
            f"the top speed is stated as {max_speed:g} {unit}/s"
            if max_speed
            else f"machines move by {low:g} to {high:g} {unit}/s"
        )
        if not low <= fastest <= high:
            factor = (max_speed or np.sqrt(low * high)) / fastest
            named = min((n for n in UNITS), key=lambda n: abs(np.log(factor / UNITS[n])))
            near = abs(np.log(factor / UNITS[named])) < np.log(30.0)
            yield Mistake(
                f"commands.csv: times are not in seconds{f' but look like {named}' if near else ''}: the "
                f"axes move by {fastest:.3g} "
                f"{unit}/s, and {against}",
                f"State t in seconds in all files ({named}: divide by {UNITS[named]:g})"
                if near
                else "Check the column t, or the unit of the lengths or angles",
                proof=0.8,
                spoils=False,
            )
            return
    gaps = np.diff(np.unique(frames))
    if len(gaps):
        rate = 1 / float(np.median(gaps))
        if not RATE[0] <= rate <= RATE[1]:
            unit_question = (
                "too far apart: are times in milliseconds?"
                if rate < RATE[0]
                else "too close together: are times in minutes or hours?"
            )
            yield Mistake(
                f"frames.csv: {rate:.3g} frames per second is implausible, they are {unit_question}",
                "State t in seconds",
                False,
                0.5,
            )


def repeated_time_mistakes(t: Floats) -> Iterator[Mistake]:
    """Mistakes of repeated times.

    All frames, or most, have the same time t (F,) s.
    """
    if len(t) > 3:
        same = int((np.diff(t) == 0).sum())
        if same > 0.2 * len(t):
            yield Mistake(
                f"frames.csv: {same + 1} of {len(t)} frames have the time of the frame before: times are "
                "rounded or copied",
                "Write t with milliseconds at least",
                True,
                0.7,
            )


FEWEST = 5  # frames and dwells by which two clocks are told
SHARE = 0.95  # of the frames, that must come to lie in dwells
UNIQUENESS = 0.9  # share of the best count, above which another place would be as good
NOW = 0.9  # of the frames, that stand as they are timed: then nothing is asked of clocks
LAG = 0.5  # s; clocks that differ by less are an effect, not a mistake
STILL = 1e-3  # of the fastest move: slower is standing, as what logs read back never stands to the last digit
MOST_PAIRS = 4_000_000


@dataclass(frozen=True, slots=True)
class DwellShift:
    """shift : s to add to frames; room : s, half the width of the shifts that serve as well; frames : how many then lie
    in a dwell; fewer : how many do at the best shift elsewhere
    """

    shift: float
    room: float
    frames: int
    fewer: int


def clock_shift_putting_most_frames_into_dwells(
    frames: Floats, t: Floats, values: Floats, need_distinct: bool = True
) -> DwellShift | None:
    """Clock shift (DwellShift) that puts the most frames into dwells of the commands.

    None if none is distinct.
    frames : (m,) s; t : (n,) s of the commands, increasing; values : (n, axes) m or rad
    need_distinct : False for one that alone puts all frames there, though another may miss only few
    """
    dwells = _dwells(t, values)
    if min(len(frames), len(dwells)) < FEWEST or len(frames) * len(dwells) > MOST_PAIRS:
        return None
    at = np.concatenate(
        [np.subtract.outer(dwells[:, 0], frames).ravel(), np.subtract.outer(dwells[:, 1], frames).ravel()]
    )
    step = np.repeat([1, -1], len(at) // 2)
    order = np.lexsort((-step, at))  # a dwell begins before another ends at the same shift
    at, count = at[order], np.cumsum(step[order])
    best = int(count.argmax())
    low, high = at[best], at[best + 1]
    far = (at < low - (dwells[:, 1] - dwells[:, 0]).max()) | (at > high + (dwells[:, 1] - dwells[:, 0]).max())
    fewer = int(count[far].max(initial=0))
    alone = not need_distinct and fewer < count[best] == len(frames)
    if not alone and (count[best] < SHARE * len(frames) or fewer > UNIQUENESS * count[best]):
        return None
    return DwellShift(float(low + high) / 2, float(high - low) / 2, int(count[best]), fewer)


def clock_offset_mistakes_of_frames_in_motion(frames: Floats, t: Floats, values: Floats) -> Iterator[Mistake]:
    """Mistakes of a clock offset by which frames seem taken in motion.

    Another offset puts them into dwells of the commands.
    frames : (m,) s; t : (n,) s of the commands; values : (n, axes) m or rad
    """
    dwells = _dwells(t, values)
    if not len(dwells):
        return
    row = np.searchsorted(dwells[:, 0], frames, side="right") - 1
    now = int(((row >= 0) & ((frames <= dwells[row, 1]) | (frames >= t[-1]))).sum())
    if now >= NOW * len(frames):
        return
    found = clock_shift_putting_most_frames_into_dwells(frames, t, values)
    if found is None or abs(found.shift) <= LAG:
        return
    side = "behind" if found.shift > 0 else "ahead of"
    yield Mistake(
        f"frames.csv: the frames' clock is {abs(found.shift):.4g} s {side} the commands' (+-{found.room:.2g} "
        f"s): {found.frames} of "
        f"{len(frames)} frames were then taken while the commands are at rest, currently {now}",
        f"{'Add' if found.shift > 0 else 'Subtract'} {abs(found.shift):.4g} s to t of frames.csv (rig import --set "
        f"images.shift={found.shift:.3f}, or poses.shift), or log both by one clock",
        proof=0.9,
    )


def _dwells(t: Floats, values: Floats) -> Floats:
    """(k, 2) s: start and end of the dwells of the commands."""
    apart = np.diff(t)
    speed = np.abs(np.diff(values, axis=0)).max(axis=1) / np.where(apart > 0, apart, np.inf)
    still = np.concatenate([[False], speed <= STILL * speed.max(initial=0.0), [False]])
    edges = np.flatnonzero(still[1:] != still[:-1])
    return t[edges].reshape(-1, 2)
