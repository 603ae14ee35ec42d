"""A plan as a table in time <-> Plan: where the axes go, when they are exposed, what the platform carries, how cubes
stand.
"""

from pathlib import Path

import numpy as np

from rig.errors import FileError
from rig.formats import csv_table
from rig.formats.input_files import value_text
from rig.model import mechanisms
from rig.model.cube_remounting import COLUMN, QUARTERS, cube_named
from rig.model.design import Design
from rig.planning.plan_construction import Plan
from rig.recording.recording_folder import PAYLOAD, Commands
from rig.recording.recording_tables import write_table
from rig.recording.time_origin import Origin, exact_decimal

MOST = 20_000  # exposures of a plan
DIGITS = 4  # of a time in a plan's table
ROWS = 5  # of a table in time for each exposure: leave, turn, arrive, hold


def plan_of_time_table(design: Design, file: str) -> Plan | None:
    """Plan of a table frame,t,l1..l6 as it stands, exposed at the rows that have a frame, with the payload of each row
    where it has a column of it; None for a table without times. Raises FileError with line and column for what is no
    such table."""
    rows = csv_table.read(Path(file), ("frame", *design.mechanism.axes), (PAYLOAD,))
    if "t" not in rows.columns:
        return None
    rows.times("t", Origin())  # which checks them
    origin = Origin(exact_decimal(rows.text("t")[0]))
    t, exposed = rows.times("t", origin), np.array([bool(cell) for cell in rows.text("frame")])
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        rows.fail("time must increase from row to row", back[0] + 1, "t")
    if not exposed.any():
        raise FileError(file, "has no row with a frame, so that nothing is exposed")
    mass = rows.numbers(PAYLOAD) if PAYLOAD in rows.columns else np.zeros(len(t))
    steps = [(0.0, float(mass[0])), *((float(t[k]), float(mass[k])) for k in np.flatnonzero(np.diff(mass)) + 1)]
    return Plan(
        Commands(t, commands_within_range(rows, design)), t[exposed], np.array(steps), origin, _cubes(rows, design)
    )


def _cubes(rows: csv_table.Table, design: Design) -> tuple[tuple[str, int], ...]:
    """(cube, quarter turns) that a table's columns turned_CUBE say. Raises FileError for a cube that there is not, and
    one that turns on the way.
    """
    out = []
    for column in rows.columns:
        if not column.startswith(COLUMN):
            continue
        name, problem = cube_named(column.removeprefix(COLUMN), design.targets)
        if problem:
            raise FileError(
                rows.path, f"column {value_text(column)}: {problem}", 1, rows.columns.index(column) + 1, column
            )
        quarters = rows.whole(column)
        for row in np.flatnonzero((quarters != quarters[0]) | (quarters >= QUARTERS))[:1]:
            rows.fail(
                f"cube {name} is turned by 0 to 3 quarter turns, and stands so for the whole plan, not by "
                f"{quarters[row]}",
                row,
                column,
            )
        out.append((name, int(quarters[0])))
    return tuple(out)


def commands_within_range(rows: csv_table.Table, design: Design) -> np.ndarray:
    """(n, axes) m or rad that a table commands. Raises FileError with the line of what is out of the axes' range."""
    values = rows.matrix(design.mechanism.axes)
    if len(rows) > MOST * ROWS:
        raise FileError(rows.path, f"has {len(rows)} rows; a plan exposes at most {MOST} times")
    beyond = mechanisms.kinematics_of(design.mechanism).limits(values, design.mechanism)
    for i in np.flatnonzero(beyond.any(axis=1)):
        rows.fail(
            f"{mechanisms.axis_places(design.mechanism)[np.flatnonzero(beyond[i])[0]]} is commanded out of its range", i
        )
    return values


def write_plan(path: Path, plan: Plan, axes: tuple[str, ...]) -> None:
    """Write a Plan as a table in time, which `build` reads as commands:FILE. axes : names of their columns, which stand
    last
    """
    loaded, exposed = np.round(plan.payload[:, 0], DIGITS), np.round(plan.t, DIGITS)
    t = np.union1d(np.round(plan.commands.t, DIGITS), np.r_[exposed, loaded])
    mass = plan.payload[np.searchsorted(loaded, t, side="right") - 1, 1]
    frames = {time: str(k) for k, time in enumerate(exposed.tolist())}
    cubes, quarters = [COLUMN + name for name, _ in plan.turned], [str(quarter) for _, quarter in plan.turned]
    rows = zip(t.tolist(), mass.tolist(), plan.commands.at(t))
    write_table(
        path,
        ("frame", "t", PAYLOAD, *cubes, *axes),
        [
            ",".join([frames.get(time, ""), f"{time:.4f}", f"{m:.6g}", *quarters, *(f"{v:.7f}" for v in row)])
            for time, m, row in rows
        ],
    )
