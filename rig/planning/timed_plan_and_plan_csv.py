"""Timed Plan, and plans as CSV.

Construction of a Plan in time: moves, dwells, exposures, payload.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import FileError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin, parse_exact_decimal
from rig.formats.local_and_remote_input_files import short_repr
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.design_comparison_and_cube_turning_instructions import COLUMN, QUARTERS, find_cube
from rig.planning.balanced_visiting_order_and_approach import balanced_approach_lengths, time_balanced_order
from rig.recording.recording_folder import PAYLOAD, Commands
from rig.recording.recording_table_loading_and_writing import write_table

DWELL = 2.0  # s at a configuration before its exposure
AFTER = 1.0  # s at it after the exposure
STEP = 0.05  # s between command rows while moving
FIRST = 0.5  # s from a move's end to the first exposure of a long dwell


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """commands : Commands; t : (frames,) s, the exposures; payload : (k, 2) s and kg, steps of what the platform
    carries
    origin : by which its times are written down
    turned : (cube, quarter turns) of cubes that are put back so before it begins; others stand as they stood"""

    commands: Commands
    t: Floats
    payload: Floats
    origin: TimeOrigin = TimeOrigin()
    turned: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ApproachSettings:
    """How configurations are approached. strokes : (axes, 2) m or rad, which are not left; below : (axes,) m or rad
    from which every axis always comes up, where the plan is one-sided, else None; rng : numpy Generator, for order and
    sides"""

    strokes: Floats
    below: Floats | None
    rng: np.random.Generator


class PlanWriter:
    """A plan being written: where the struts are, when, and what has been exposed. approach : of configurations, None
    for straight ways
    """

    def __init__(self, start: Floats, speed: float | Floats, approach: ApproachSettings | None = None) -> None:
        self.t, self.values, self.payload = [0.0, 1.0], [start, start], [(0.0, 0.0)]
        self.exposures: list[float] = []
        self.turned: dict[str, int] = {}
        self.speed, self.approach = speed, approach

    def go(self, goal: Floats) -> None:
        """Move there at the speed of the plan (axes,) m or rad."""
        seconds = float((np.abs(goal - self.values[-1]) / self.speed).max())
        if seconds > 0:
            self.t.append(self.t[-1] + max(seconds, STEP))
            self.values.append(goal)

    def dwell(self, seconds: float) -> None:
        """Stay for so long (s)."""
        self.t.append(self.t[-1] + seconds)
        self.values.append(self.values[-1])

    def settle(self, goal: Floats, last: Floats | None = None) -> None:
        """Go there, dwell, expose once settled. last : (axes,) m or rad by which each axis moves last, None straight;
        where the plan is one-sided every axis comes from below"""
        if self.approach is not None and self.approach.below is not None:
            last = self.approach.below
        if last is not None:
            self.go(goal - last)
        self.go(goal)
        self.dwell(DWELL + AFTER)
        self.exposures.append(self.t[-1] - AFTER)

    def visit(self, goals: Floats) -> None:
        """Settle at each of the configurations (n, axes), in an order and from sides that are no function of place (see
        rig.planning.balanced_visiting_order_and_approach)."""
        self.follow(self.shuffled(goals))

    def follow(self, goals: Floats) -> None:
        """Settle at each of the configurations (n, axes) in their order, from sides that are no function of place."""
        for goal, last in zip(goals, self.approaches(goals)):
            self.settle(goal, last)

    def shuffled(self, goals: Floats) -> Floats:
        """Configurations (n, axes) in an order in which time is no function of place."""
        return np.asarray(goals)[time_balanced_order(goals, self._sided().rng)]

    def approaches(self, goals: Floats, others: Sequence[Floats] = ()) -> Floats:
        """(n, axes) m or rad, last moves to configurations in their order, whose sides are no function of place, time
        and others (n,).
        """
        approach = self._sided()
        return balanced_approach_lengths(goals, approach.rng, approach.strokes, others)

    def _sided(self) -> ApproachSettings:
        if self.approach is None:
            raise ValueError("a writer without an Approach goes straight, in the order given")
        return self.approach

    def watch(self, count: int, seconds: float) -> None:
        """Stay for so long (s), and expose so often meanwhile: often at first, when what comes late moves fastest."""
        start = self.t[-1]
        self.exposures += (start + np.geomspace(FIRST, seconds, count)).tolist()
        self.dwell(seconds + AFTER)

    def plan(self) -> Plan:
        """What was written so far, exposures in order of time."""
        order = np.argsort(self.exposures)
        return Plan(
            Commands(np.round(self.t, 4), np.round(self.values, 7)),
            np.round(np.array(self.exposures)[order], 4),
            np.round(self.payload, 4),
            turned=tuple(self.turned.items()),
        )


MOST = 20_000  # exposures of a plan
DIGITS = 4  # of a time in a plan's table
ROWS = 5  # of a table in time for each exposure: leave, turn, arrive, hold


def plan_of_time_table(design: Design, path: str) -> Plan | None:
    """Plan of a table with times (frame,t,l1..l6).

    None for a table without times.
    Raises FileError with line and column for what is no such table.
    """
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(
        Path(path), ("frame", *design.mechanism.axes), (PAYLOAD,)
    )
    if "t" not in rows.columns:
        return None
    rows.times("t", TimeOrigin())  # which checks them
    origin = TimeOrigin(parse_exact_decimal(rows.text("t")[0]))
    t, exposed = rows.times("t", origin), np.array([bool(cell) for cell in rows.text("frame")])
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        rows.fail("time must increase from row to row", back[0] + 1, "t")
    if not exposed.any():
        raise FileError(path, "has no row with a frame, so that nothing is exposed")
    mass = rows.numbers(PAYLOAD) if PAYLOAD in rows.columns else np.zeros(len(t))
    steps = [(0.0, float(mass[0])), *((float(t[k]), float(mass[k])) for k in np.flatnonzero(np.diff(mass)) + 1)]
    return Plan(
        Commands(t, require_commands_in_range(rows, design)), t[exposed], np.array(steps), origin, _cubes(rows, design)
    )


def _cubes(rows: csv_and_parquet_tables_and_time_origin.Table, design: Design) -> tuple[tuple[str, int], ...]:
    """(cube, quarter turns) that a table's columns turned_CUBE say. Raises FileError for a cube that there is not, and
    one that turns on the way.
    """
    out = []
    for column in rows.columns:
        if not column.startswith(COLUMN):
            continue
        name, problem = find_cube(column.removeprefix(COLUMN), design.targets)
        if problem:
            raise FileError(
                rows.path, f"column {short_repr(column)}: {problem}", 1, rows.columns.index(column) + 1, column
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


def require_commands_in_range(table: csv_and_parquet_tables_and_time_origin.Table, design: Design) -> Floats:
    """Commands (n, axes) m or rad of a table, required in range.

    Raises FileError with the line of one that is not.
    """
    values = table.matrix(design.mechanism.axes)
    if len(table) > MOST * ROWS:
        raise FileError(table.path, f"has {len(table)} rows; a plan exposes at most {MOST} times")
    beyond = mechanisms.kinematics_of(design.mechanism).signed_limit_excess(values, design.mechanism)
    for i in np.flatnonzero(beyond.any(axis=1)):
        axis = mechanisms.axis_place_texts(design.mechanism)[np.flatnonzero(beyond[i])[0]]
        table.fail(f"{axis} is commanded out of its range", i)
    return values


def write_plan_table(path: Path, plan: Plan, axis_names: tuple[str, ...]) -> None:
    """Write a Plan as a table in time, which `build_plan` reads as commands:FILE.
    axis_names : names of their columns, which stand last
    """
    loaded, exposed = np.round(plan.payload[:, 0], DIGITS), np.round(plan.t, DIGITS)
    t = np.union1d(np.round(plan.commands.t, DIGITS), np.r_[exposed, loaded])
    mass = plan.payload[np.searchsorted(loaded, t, side="right") - 1, 1]
    frames = {time: str(k) for k, time in enumerate(exposed.tolist())}
    cubes, quarters = [COLUMN + name for name, _ in plan.turned], [str(quarter) for _, quarter in plan.turned]
    rows = zip(t.tolist(), mass.tolist(), plan.commands.at(t))
    write_table(
        path,
        ("frame", "t", PAYLOAD, *cubes, *axis_names),
        [
            ",".join([frames.get(time, ""), f"{time:.4f}", f"{m:.6g}", *quarters, *(f"{v:.7f}" for v in row)])
            for time, m, row in rows
        ],
    )
