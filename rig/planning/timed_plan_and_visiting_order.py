"""Timed plan, and the order of visits.

Neither time nor direction correlates with position.

A correction fitted to place absorbs whatever goes with place. A Sobol sequence in its own order comes to the upper half
of a stroke from below and to the lower half from above, so that play looks like a map; a grid in serpentine order goes
with time, so that drift does.
Source: Box, Hunter and Hunter, Statistics for Experimenters, 2nd ed., ch. 4 and 5 (randomise what cannot be blocked,
    balance what can)

A Plan in time has moves, dwells, exposures and payloads.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.errors import FileError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin, parse_exact_decimal
from rig.formats.local_and_remote_input_files import short_repr
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.design_contradictions_and_cube_quarter_turns import COLUMN, QUARTERS, cube_name_or_problem
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links
from rig.recording.corner_and_pose_csv_tables import write_table
from rig.recording.recording_folder import PAYLOAD, Commands, require_follower_joint_values_match_leaders

TRIED = 64  # exchanges of two configurations that are compared at once
REACHES = (0.02, 0.2)  # of the stroke, shortest and longest last move
ROOM = 0.95  # of what is left to the stroke's end, that a last move takes at most
ROUNDS = 600  # of exchanges, and of turned sides, at most
MIDDLE = 3.0  # weight of as many sides above as below, beside correlations
SECONDARY = 0.5  # weight of time, load and the sides of other axes, beside place
RIDGE = 0.05  # variance added to each, so that few configurations are balanced as far as they go
SMALL = 1e-9  # of a sum of squared correlations, below which an exchange gains nothing


def time_balanced_order(configurations: Floats, rng: np.random.Generator) -> Integers:
    """Order (n,) of configurations in which time is balanced against position.

    Shuffled, then exchanged in pairs while the sum of squared correlations over all axes becomes less. Sides are chosen
    apart (see `balanced_approach_lengths`).
    """
    n = len(configurations)
    order = rng.permutation(n)
    if n < 4:
        return order
    place = _place(configurations)[0]
    smooth = _apart(place[:, : 2 * configurations.shape[1]])  # a drift goes with time, and is no matter of halves
    time = _standard(np.column_stack([np.linspace(-1, 1, n), np.linspace(-1, 1, n) ** 2]))
    for _ in range(ROUNDS):
        a, b = rng.integers(n, size=(2, TRIED))
        apart = np.abs(a - b) > 1
        a, b = a[apart], b[apart]
        if not len(a):
            continue
        now = smooth[order]
        sums = time.T @ now + np.einsum("kt,kp->ktp", time[a] - time[b], now[b] - now[a])
        costs = (sums**2).sum(axis=(1, 2))
        base = float(((time.T @ now) ** 2).sum())
        best = int(np.argmin(costs))
        if costs[best] < base * (1 - SMALL):
            order[[a[best], b[best]]] = order[[b[best], a[best]]]
    return order


def balanced_approach_lengths(
    configurations: Floats, rng: np.random.Generator, strokes: Floats, other_variables: Sequence[Floats] = ()
) -> Floats:
    """Lengths of approaches (n, axes) m or rad to configurations, balanced by side.

    Positive from below.

    Sides are those of `_balanced_sides`; lengths are drawn from REACHES of the strokes (axes, 2), evenly on a
    logarithmic scale, so that what follows the size of a move differs from what follows its direction, and end before
    the stroke does. other_variables : as there
    """
    extent = np.ptp(strokes, axis=1)
    sides = _balanced_sides(configurations, rng, REACHES[0] * extent, strokes, other_variables)
    drawn = extent * REACHES[0] * (REACHES[1] / REACHES[0]) ** rng.random(configurations.shape)
    return np.asarray(
        sides
        * np.minimum(drawn, ROOM * np.where(sides > 0, configurations - strokes[:, 0], strokes[:, 1] - configurations))
    )


def _balanced_sides(
    values: Floats, rng: np.random.Generator, reach: Floats, strokes: Floats, others: Sequence[Floats] = ()
) -> Floats:
    """(n, axes) sides from which each axis comes to configurations values (n, axes), m or rad, in their order: 1 from
    below, -1 from above.

    At random, then turned one by one until place, time, others (n,) and the sides of other axes together explain the
    least of the side, axis by axis.
    reach : (axes,) m or rad, by which an axis moves last at least; strokes : (axes, 2), which it does not leave: at an
    end an axis comes from within
    """
    n, axes = values.shape
    place, own = _place(values)
    time = np.linspace(-1, 1, max(n, 2))[:n]
    sides = np.zeros((n, axes))
    for i in range(axes):
        fixed = 1 * (values[:, i] + reach[i] > strokes[i, 1]) - 1 * (values[:, i] - reach[i] < strokes[i, 0])
        causes = np.column_stack([_standard(np.column_stack([time, time**2, *others])), sides[:, :i]])
        columns = np.column_stack([np.full(n, MIDDLE), _apart(place[:, own[i] > 0]), SECONDARY * causes])
        side = np.where(fixed, fixed, rng.permutation(np.where(np.arange(n) % 2, 1.0, -1.0)))
        sides[:, i] = _turned(side, columns, fixed == 0)
    return sides


def _turned(side: Floats, columns: Floats, free: Floats) -> Floats:
    """Sides (n,) of which the free ones are turned, one or two at a time, while the squared sums with columns (n, p)
    become less.
    """
    own = (columns**2).sum(axis=1)
    if not free.any():
        return side
    sums = columns.T @ side
    for _ in range(ROUNDS):
        change = np.where(
            free, 4 * own - 4 * side * (columns @ sums), np.inf
        )  # |sums - 2 side_k columns_k|^2 - |sums|^2
        best = int(np.argmin(change))
        if change[best] >= -SMALL:  # none gains alone: two at once
            pair = (
                change[:, None] + change + 8 * np.outer(side, side) * (columns @ columns.T)
                if len(side) <= TRIED
                else np.full((1, 1), np.inf)
            )
            np.fill_diagonal(pair, np.inf)
            if not pair.min() < -SMALL:
                break
            turned = [int(k) for k in np.unravel_index(int(np.argmin(pair)), pair.shape)]
        else:
            turned = [best]
        sums = sums - 2 * side[turned] @ columns[turned]
        side[turned] *= -1
    return side


def _place(values: Floats) -> tuple[Floats, Floats]:
    """(functions of place (n, 3 axes), standardised: every axis, its square and the half of its stroke; (axes, 3 axes)
    bool which count for the direction of an axis: all axes' places, and of its own the square and the half)."""
    axes = values.shape[1]
    span = np.ptp(values, axis=0)
    unit = 2 * (values - values.min(axis=0)) / np.where(span > 0, span, 1.0) - 1
    own = np.concatenate([np.ones((axes, axes)), np.eye(axes), np.eye(axes)], axis=1)
    return _standard(np.concatenate([unit, unit**2, np.sign(np.round(unit, 9))], axis=1)), own


def _standard(columns: Floats) -> Floats:
    """Columns (n, p) of mean 0 and mean square 1; of 0 where they are constant."""
    centred = columns - columns.mean(axis=0)
    size = np.sqrt((centred**2).mean(axis=0))
    return np.asarray(centred / np.where(size > SMALL, size, np.inf))


def _apart(columns: Floats) -> Floats:
    """Columns (n, p) made nearly uncorrelated: of a side their squared sums over n^2 are the share that all together
    explain.
    """
    size, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
    return np.asarray(columns @ vectors / np.sqrt(size + RIDGE))


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
        rig.planning.timed_plan_and_visiting_order)."""
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
        name, problem = cube_name_or_problem(column.removeprefix(COLUMN), design.targets)
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

    Raises FileError with the line of one that is not, and of a joint that is not where its leader has it.
    """
    values = table.matrix(design.mechanism.axes)
    if len(table) > MOST * ROWS:
        raise FileError(table.path, f"has {len(table)} rows; a plan exposes at most {MOST} times")
    beyond = mechanisms.kinematics_of(design.mechanism).signed_limit_excess(values, design.mechanism)
    for i in np.flatnonzero(beyond.any(axis=1)):
        axis = mechanisms.axis_place_texts(design.mechanism)[np.flatnonzero(beyond[i])[0]]
        table.fail(f"{axis} is commanded out of its range", i)
    if has_links(design.mechanism):
        require_follower_joint_values_match_leaders(table, values, design.mechanism)
    return values


def write_plan_table(path: Path, plan: Plan, axis_names: tuple[str, ...]) -> None:
    """Write a Plan as a table.

    In time; `build_plan` reads it as commands:FILE.
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
