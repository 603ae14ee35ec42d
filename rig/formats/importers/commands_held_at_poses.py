"""Commands of a table that has one row for each pose, with the machine at rest at each.

Between the rows of a log an axis moves linearly. A table of poses is no log: its rows are where the machine stood while
it was measured, and the times that two programs wrote of one such moment differ by some of what passes between rows.
Read as a log, they would place every measurement into a move.
"""

from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.checks.mistake_dataclass_and_clock_mistakes import STILL
from rig.errors import RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import DIGITS
from rig.formats.importers.exposures_from_image_names import ImportedExposures
from rig.formats.importers.foreign_command_table import ImportedCommands
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.importers.imported_frame_times_from_names_tables_or_commands import seconds_since_origin

HELD, MOVING = "held", "moving"  # what is stated of rows
FEWEST = 8  # rows, from which it is found out what they are
MOST_STILL = 0.25  # share of the intervals in which nothing moves; a log with dwells has more
SHARE = 0.75  # of the rows, that must have a pose of their own
NEAR = 0.1  # of the time to the nearest row, up to which a pose may be from its own
SHORTEST = 4.0  # s between rows (median); faster ones may be a log of a machine that moves on
ONE_CLOCK = 0.05  # s that poses may be from their rows on the average, though these scatter less
ERRORS = 3.0  # standard errors of that average, up to which it may be none
SMOOTH = 0.5  # mean cosine of successive steps, above which rows may follow a path
SETTLED = 0.25  # of the time between two rows, that the machine stands before and after it is measured
LONGEST = 1.0  # s, the same at the most


@dataclass(frozen=True, slots=True)
class _Frames:
    """Exposures of frames. first, last : n exact s of the first and last camera of each; middle : n between these"""

    first: list[Decimal]
    last: list[Decimal]
    middle: list[Decimal]


@dataclass(frozen=True, slots=True)
class _Belonging:
    """frame : (n,) index of each row's frame in time, or -1; late : (m,) s of each frame after its row."""

    frame: Integers
    late: Floats

    def apart(self) -> float:
        """S, the most that a frame is from its row."""
        return float(np.abs(self.late).max())

    def mean(self) -> float:
        """S, by which frames are after their rows on the average."""
        return float(self.late.mean())

    def is_of_one_clock(self) -> bool:
        """Whether frames scatter about their rows, rather than all being early or late."""
        error = self.late.std(ddof=1) / np.sqrt(len(self.late)) if len(self.late) > 1 else 0.0
        return abs(self.mean()) <= max(ONE_CLOCK, ERRORS * float(error))


def commands_held_at_poses(exposed: ImportedExposures, commanded: ImportedCommands | None) -> ImportedCommands | None:
    """Commands with a dwell at each row, where the rows are configurations at which one pose each was measured.

    commanded : with times; `rows` of its table states "held" or "moving"; where it does not, rows are held that are
    seconds apart, follow no path, rarely repeat, and have a frame each within a tenth of the time between rows, as
    often before as after. Where all are early or late, a remark says so.
    Raises RigError where they are stated as held and frames cannot be assigned to them
    """
    if commanded is None or commanded.t is None or commanded.table.rows == MOVING or len(commanded.t) < 2:
        return commanded
    stated, name = commanded.table.rows == HELD, commanded.table.file.name
    t = seconds_since_origin(commanded.t, commanded.t[0])
    count = len(set(exposed.frame))
    is_ordered = bool((np.diff(t) > 0).all())
    if stated and not is_ordered:
        raise RigError(f"{name}: commands.rows=held takes rows in order of time; sort them, or leave it out")
    if not is_ordered or not (stated or _may_be_configurations(t, commanded.values, count)):
        return commanded
    frames = _frames(exposed)
    found = _belonging(t, seconds_since_origin(frames.middle, commanded.t[0]))
    if stated and found is None:
        raise RigError(
            f"{name}: commands.rows=held means a row for each pose, but two frames or more are "
            "nearest to one row; leave it out, or set commands.shift=S, which adds S to its times"
        )
    if found is None or not (stated or found.apart() <= NEAR * np.diff(t).min()):
        return commanded
    if not stated and not found.is_of_one_clock():
        return replace(commanded, remarks=(*commanded.remarks, _of_two_clocks(commanded.table, found)))
    has = int((found.frame >= 0).sum())
    line = (
        f"{has} of {len(t)} rows of {name} have a pose of their own, within {found.apart():.3g} s: the machine is "
        "assumed to stand still at each row; --set commands.rows=moving if it moved on"
    )
    return _with_dwells(commanded, frames, found, () if stated else (line,))


def _of_two_clocks(table: ForeignTable, found: _Belonging) -> str:
    """A sentence on poses that are all early or late of rows that would be held."""
    late = found.mean()
    return (
        f"poses are {abs(late):.3g} s {'after' if late > 0 else 'before'} the rows of {table.file.name} on the "
        f"average, which is read as a log: clocks may differ, --set commands.shift={table.shift + late:.3f} puts rows "
        "and poses together; --set commands.rows=held if the machine stood still at each row"
    )


def _frames(exposed: ImportedExposures) -> _Frames:
    """The frames in order of time; cameras with times of their own may be of one."""
    own: dict[int, list[Decimal]] = {}
    for frame, t in zip(exposed.frame, exposed.times()):
        own.setdefault(frame, []).append(t)
    spans = sorted((min(times), max(times)) for times in own.values())
    first, last = [first for first, _ in spans], [last for _, last in spans]
    return _Frames(first, last, [DIGITS.divide(DIGITS.add(a, b), Decimal(2)) for a, b in spans])


def _with_dwells(
    commanded: ImportedCommands, frames: _Frames, found: _Belonging, remarks: tuple[str, ...]
) -> ImportedCommands:
    """Commands with two rows for each: before it and its frame, and behind both."""
    t = commanded.t or []
    first = [s if k < 0 else min(s, frames.first[k]) for s, k in zip(t, found.frame)]
    last = [s if k < 0 else max(s, frames.last[k]) for s, k in zip(t, found.frame)]
    gaps = [float(arrived - left) for left, arrived in zip(last, first[1:])]
    rests = [Decimal(f"{min(LONGEST, SETTLED * gap):.6f}") for gap in gaps]
    starts = [DIGITS.subtract(s, rest) for s, rest in zip(first, [Decimal(repr(LONGEST)), *rests])]
    ends = [DIGITS.add(s, rest) for s, rest in zip(last, [*rests, Decimal(repr(LONGEST))])]
    rows = [(moment, k) for k, pair in enumerate(zip(starts, ends)) for moment in pair]
    return replace(
        commanded,
        t=[moment for moment, _ in rows],
        values=commanded.values[[k for _, k in rows]],
        frame=None if commanded.frame is None else commanded.frame[[k for _, k in rows]],
        remarks=(*commanded.remarks, *remarks),
    )


def _belonging(t: Floats, at: Floats) -> _Belonging | None:
    """The frame of each row: that nearest to it. None where two frames are nearest to one row.

    t : (n,) s of rows; at : (m,) s of frames, both increasing
    """
    if len(at) > len(t):
        return None
    after = np.minimum(np.maximum(np.searchsorted(t, at), 1), len(t) - 1)
    nearest = np.where(at - t[after - 1] <= t[after] - at, after - 1, after)
    if (np.diff(nearest) == 0).any():
        return None
    frame = np.full(len(t), -1)
    frame[nearest] = np.arange(len(at))
    return _Belonging(frame, at - t[nearest])


def _may_be_configurations(t: Floats, values: Floats, count: int) -> bool:
    """Whether rows may be configurations and no log of moves. t : (n,) s; values : (n, axes); count : of frames"""
    if len(t) < FEWEST or not SHARE * len(t) <= count <= len(t) or np.median(np.diff(t)) < SHORTEST:
        return False
    steps = np.diff(values, axis=0) / np.maximum(np.ptp(values, axis=0), 1e-12)
    size = np.linalg.norm(steps, axis=1)
    moved = size > STILL * size.max(initial=0.0)
    if (~moved).mean() > MOST_STILL:
        return False
    pairs = moved[1:] & moved[:-1]
    cosines = np.einsum("ki,ki->k", steps[1:], steps[:-1])[pairs] / (size[1:] * size[:-1])[pairs]
    return bool(len(cosines)) and float(cosines.mean()) < SMOOTH
