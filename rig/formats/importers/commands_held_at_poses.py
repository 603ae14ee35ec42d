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
from rig.formats.importers.imported_frame_times_from_names_tables_or_commands import seconds_since_origin

HELD, MOVING = "held", "moving"  # what is stated of rows
FEWEST = 8  # rows, from which it is found out what they are
MOST_STILL = 0.25  # share of the intervals in which nothing moves; a log with dwells has more
SHARE = 0.75  # of the rows, that must have a pose of their own
NEAR = 0.1  # of the time to the nearest row, up to which a pose may be from its own
SLOWEST = 1.0  # s between rows (median); faster ones may be of a machine that moves on
SMOOTH = 0.5  # mean cosine of successive steps, above which rows may follow a path
SETTLED = 0.25  # of the time between two rows, that the machine stands before and after it is measured
LONGEST = 1.0  # s, the same at the most


@dataclass(frozen=True, slots=True)
class _Belonging:
    """frame : (n,) index of each row's frame in time, or -1; apart : s, the most that one is from its row."""

    frame: Integers
    apart: float


def commands_held_at_poses(exposed: ImportedExposures, commanded: ImportedCommands | None) -> ImportedCommands | None:
    """Commands with a dwell at each row, where the rows are configurations at which one pose each was measured.

    commanded : with times; `rows` of its table states "held" or "moving"; where it does not, rows are held that are
    seconds apart, follow no path, rarely repeat, and have a frame each within a tenth of the time between rows
    Raises RigError where they are stated as held and frames cannot be assigned to them
    """
    if commanded is None or commanded.t is None or commanded.table.rows == MOVING or len(commanded.t) < 2:
        return commanded
    stated = commanded.table.rows == HELD
    frames = sorted(set(exposed.times()))
    t = seconds_since_origin(commanded.t, commanded.t[0])
    at = seconds_since_origin(frames, commanded.t[0])
    found = _belonging(t, at)
    if stated and found is None:
        raise RigError(
            f"{commanded.table.file.name}: commands.rows=held means a row for each pose, but two frames or more are "
            "nearest to one row; leave it out, or set commands.shift=S, which adds S to its times"
        )
    if found is None or not (stated or _are_configurations(t, commanded.values, found)):
        return commanded
    own = [t if k < 0 else frames[k] for t, k in zip(commanded.t, found.frame)]
    first = [min(pair) for pair in zip(commanded.t, own)]
    last = [max(pair) for pair in zip(commanded.t, own)]
    gaps = [float(arrived - left) for left, arrived in zip(last, first[1:])]
    rests = [Decimal(f"{min(LONGEST, SETTLED * gap):.6f}") for gap in gaps]
    starts = [DIGITS.subtract(t, rest) for t, rest in zip(first, [Decimal(repr(LONGEST)), *rests])]
    ends = [DIGITS.add(t, rest) for t, rest in zip(last, [*rests, Decimal(repr(LONGEST))])]
    rows = [(moment, k) for k, pair in enumerate(zip(starts, ends)) for moment in pair]
    line = (
        f"each row of {commanded.table.file.name} has a pose of its own, within {found.apart:.3g} s: the machine is "
        "assumed to stand still at each while it is measured; --set commands.rows=moving if it moved on"
    )
    return replace(
        commanded,
        t=[moment for moment, _ in rows],
        values=commanded.values[[k for _, k in rows]],
        frame=None if commanded.frame is None else commanded.frame[[k for _, k in rows]],
        remarks=(*commanded.remarks, *(() if stated else (line,))),
    )


def _belonging(t: Floats, at: Floats) -> _Belonging | None:
    """The frame of each row: that nearest to it. None where two frames are nearest to one row.

    t : (n,) s of rows; at : (m,) s of frames, both increasing
    """
    nearest = np.abs(np.subtract.outer(at, t)).argmin(axis=1)
    if len(np.unique(nearest)) < len(at):
        return None
    frame = np.full(len(t), -1)
    frame[nearest] = np.arange(len(at))
    return _Belonging(frame, float(np.abs(at - t[nearest]).max()))


def _are_configurations(t: Floats, values: Floats, found: _Belonging) -> bool:
    """Whether rows are configurations and no log of moves. t : (n,) s; values : (n, axes)"""
    gaps, steps = np.diff(t), np.diff(values, axis=0) / np.maximum(np.ptp(values, axis=0), 1e-12)
    size = np.linalg.norm(steps, axis=1)
    moved = size > STILL * size.max(initial=0.0)
    if len(t) < FEWEST or np.median(gaps) < SLOWEST or (~moved).mean() > MOST_STILL:
        return False
    if (found.frame >= 0).sum() < SHARE * len(t) or found.apart > NEAR * gaps.min():
        return False
    pairs = moved[1:] & moved[:-1]
    cosines = np.einsum("ki,ki->k", steps[1:], steps[:-1])[pairs] / (size[1:] * size[:-1])[pairs]
    return bool(len(cosines)) and float(cosines.mean()) < SMOOTH
