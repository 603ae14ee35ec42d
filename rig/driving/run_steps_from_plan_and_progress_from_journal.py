"""Steps of a run from its plan, and its progress from its journal.

Steps come from its plan and are checked before motion; progress is read from its journal.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.run_journal import (
    Arrival,
    Began,
    CameraExposures,
    Departure,
    Ended,
    Exposed,
    PositionReports,
    PositionUnknown,
    Readings,
    Remark,
    Resumed,
    Row,
)
from rig.errors import RigError, Unreachable
from rig.planning.timed_plan_and_visiting_order import AFTER, DWELL, Plan

STANDING = 1e-9  # m; commands that differ by less are one place
INSTANT = 1e-6  # s about an exposure in which the struts must not move


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One move and what follows it. goal : (axes,) m; frames : how many exposures are taken there, 0 for a place passed
    on the way; speed : m/s of the strut that moves most where cameras expose during the move, None where they do not
    rests : (frames + 1,) s that the plan stands there from the arrival or an exposure until the next exposure, and
        until it leaves, 0 for what settling takes anyway; () for none
    """

    goal: Floats
    frames: int
    speed: float | None = None
    rests: tuple[float, ...] = ()

    def rest_before(self, frame: int) -> float:
        """s that the plan stands before the exposure with this number, or before it leaves."""
        return self.rests[frame] if self.rests else 0.0


def steps_of_plan(plan: Plan) -> tuple[Step, ...]:
    """Steps of a plan.

    Each goal where its commands turn or dwell, the number of frames exposed there, and rests longer than a settling.
    Raises RigError for a plan that exposes while the struts move, or that changes the payload: a run waits until the
    struts stand, and nobody is asked to load the platform.
    """
    if (plan.payload[:, 1] > 0).any():
        raise RigError(
            f"the plan changes the payload ({plan.payload[:, 1].max():g} kg); a run does not load the "
            "platform: run it in parts"
        )
    rows = plan.commands.values
    moved = np.r_[True, np.abs(np.diff(rows, axis=0)).max(axis=1) > STANDING]
    place = np.cumsum(moved) - 1  # of each row
    goals = rows[moved]
    exposures: list[list[float]] = [[] for _ in goals]
    for t in plan.t:
        after = min(int(np.searchsorted(plan.commands.t, t + INSTANT, side="left")), len(rows) - 1)
        before = max(int(np.searchsorted(plan.commands.t, t - INSTANT, side="right")) - 1, 0)
        if place[after] != place[before]:
            raise RigError(
                f"the plan exposes at t = {t:g} s while the struts move; a run exposes where they stand "
                "(leave out moving and zigzag)"
            )
        exposures[place[before]].append(float(t))
    arrived = plan.commands.t[np.flatnonzero(moved)]
    left = np.r_[plan.commands.t[np.flatnonzero(moved)[1:] - 1], plan.commands.t[-1]]
    last = max(k for k, times in enumerate(exposures) if times)
    return tuple(
        Step(goal, len(times), rests=_rests(begun, times, ended if k < last else 0.0))
        for k, (goal, times, begun, ended) in enumerate(zip(goals[: last + 1], exposures, arrived, left))
    )


def _rests(arrived: float, exposures: list[float], left: float) -> tuple[float, ...]:
    """Rests of a Step whose plan arrives, exposes and leaves at these times (s)."""
    rests = np.diff([arrived, *exposures, left])
    rests[rests <= DWELL + AFTER + INSTANT] = 0.0
    return tuple(rests.tolist()) if rests.any() else ()


def steps_with_exposures_in_motion(steps: tuple[Step, ...], speed: float, max_speed: Floats) -> tuple[Step, ...]:
    """Steps of a plan as moves at a speed (m/s) with exposures during each.

    The speed is that of the fastest strut.
    max_speed : (axes,) m/s. Raises RigError for a speed that a strut may not have.
    """
    if not 0 < speed <= max_speed.min():
        raise RigError(
            f"--in-motion {speed * 1e3:g} mm/s: [controller] max_speed allows above 0 and at most "
            f"{max_speed.min() * 1e3:g} mm/s"
        )
    return tuple(Step(step.goal, 0, speed, (sum(step.rests),) if step.rests else ()) for step in steps)


def require_all_steps_permitted(
    steps: tuple[Step, ...], start: Floats, check_move: Callable[[Floats, Floats], None]
) -> None:
    """Require that all steps are permitted, from start (axes,) m on.

    Goals and paths are checked before anything moves.
    check_move : (start, goal) -> None, raises RigError where the move may not be made. Raises Unreachable listing all
        that may not.
    """
    refused, at = [], start
    for k, step in enumerate(steps):
        try:
            check_move(at, step.goal)
        except RigError as error:
            refused.append((k, f"step {k}: {error}"))
        at = step.goal
    if refused:
        raise Unreachable(
            f"{len(refused)} of {len(steps)} moves of the plan cannot be made; nothing has moved:",
            [k for k, _ in refused],
            [line for _, line in refused],
        )


def longest_axis_distance_of_steps(steps: tuple[Step, ...], start: Floats) -> Floats:
    """Longest distance (steps,) m that an axis moves in each step."""
    goals = np.array([start, *(step.goal for step in steps)])
    return np.abs(np.diff(goals, axis=0)).max(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """step : index of the one that is under way or next; frames : exposures taken at it; number : of the next frame
    position : (axes,) m, where the struts were last known to stand; pending : the Departure that has no arrival, or
        None
    arrived : whether they stand at the step's goal; t : s of the last row; ended : why the run ended, None while it has
        not
    lost : why their position is not known, "" where it is; exposures : {camera: s} as last set
    """

    step: int
    frames: int
    number: int
    position: Floats
    pending: Departure | None
    arrived: bool
    t: float
    ended: str | None
    lost: str = ""
    exposures: dict[str, float] = field(default_factory=dict)


def progress_from_journal(journal_rows: list[Row], steps: tuple[Step, ...]) -> Progress:
    """Progress of a run from its journal rows.

    Raises RigError for rows that no run of this plan leaves.
    """
    if not journal_rows or not isinstance(journal_rows[0], Began):
        raise RigError("the journal contains no start of a run")
    if journal_rows[0].steps != len(steps):
        raise RigError(f"the journal is of a plan of {journal_rows[0].steps} steps, this one has {len(steps)}")
    step = frames = number = 0
    pending, arrived, ended, position = None, False, None, np.array(journal_rows[0].position)
    lost, exposures = "", dict[str, float]()
    for row in journal_rows:
        ended = (
            row.reason
            if isinstance(row, Ended)
            else ended
            if isinstance(row, Remark | Readings | PositionReports)
            else None
        )
        if isinstance(row, Departure):
            if row.step != step:  # the one before was done
                if row.step != step + 1 or frames < steps[step].frames:
                    raise RigError(
                        f"the journal leaves step {step} with {frames} of {steps[step].frames} frames for "
                        f"step {row.step}"
                    )
                step, frames = row.step, 0
            pending, arrived, position = row, False, np.array(row.start)
        elif isinstance(row, Arrival):
            pending, arrived, position = None, row.reached, np.array(row.position)
        elif isinstance(row, Resumed):
            position, lost = np.array(row.position), ""
            arrived = arrived and bool(np.abs(position - steps[step].goal).max() <= 0)
        elif isinstance(row, PositionUnknown):
            lost = row.reason
        elif isinstance(row, CameraExposures):
            exposures |= dict(zip(row.cameras, row.seconds))
        elif isinstance(row, Exposed):
            frames, number = frames + 1, row.frame + 1
    return Progress(step, frames, number, position, pending, arrived, journal_rows[-1].t, ended, lost, exposures)


def start_position_of_step(journal_rows: list[Row], steps: tuple[Step, ...], index: int) -> Floats:
    """Axis values (axes,) m where a step of a run starts.

    The goal before it, or where the run began.
    Raises RigError for rows that no run leaves.
    """
    if not journal_rows or not isinstance(journal_rows[0], Began):
        raise RigError("the journal contains no start of a run")
    return steps[index - 1].goal if index else np.array(journal_rows[0].position)


def position_loss_reason(
    progress: Progress, position: Floats, tolerance: float, controller_restarted: bool, can_home: bool, unit: str = "mm"
) -> str:
    """Reason why the position (axes,) m or rad counts as lost, "" where it does not.

    It is read when a run is resumed.
    tolerance : m or rad, of a read-back; controller_restarted : whether the controller says that it started since
    it was homed or confirmed; can_home : whether it can home. One that cannot shows lost zeros only by axes that
    read elsewhere. unit : name of a thousandth of m or rad
    """
    if progress.lost:
        return f"the run ended with the position lost ({progress.lost})"
    if controller_restarted:
        return "the controller has started anew since the run left it"
    left = progress.position if progress.pending is None else np.asarray(progress.pending.start)
    goal = left if progress.pending is None else np.asarray(progress.pending.goal)
    beyond = np.maximum(np.minimum(left, goal) - position, position - np.maximum(left, goal)).max()
    if can_home or beyond <= tolerance:
        return ""
    return (
        f"the axes read {beyond * 1e3:.3f} {unit} from where the run left them, and [controller] homing = false: "
        "either they were moved or the controller lost its zeros"
    )


def interrupted_move_text_and_goal_reached(
    progress: Progress, steps: tuple[Step, ...], position: Floats, tolerance: float, unit: str = "mm"
) -> tuple[str, bool]:
    """Text of what became of an interrupted move, and whether its goal is reached.

    From the position read after a crash.
    tolerance : m or rad, of a read-back; unit : name of a thousandth of m or rad
    Returns (text, whether the goal is reached)
    """

    def near(place: object) -> bool:
        return bool(np.abs(position - np.asarray(place)).max() <= tolerance)

    def off(place: object) -> str:
        return f"{np.abs(position - np.asarray(place)).max() * 1e3:.3f} {unit}"

    goal = steps[progress.step].goal
    if progress.pending is not None:
        if np.abs(np.asarray(progress.pending.goal) - goal).max() > STANDING:
            return f"step {progress.step} was on its way back to its start", False
        if near(goal) and steps[progress.step].speed is not None:
            return f"the move of step {progress.step} was done, but not seen to its end: it is made again", False
        if near(goal):
            return f"the move of step {progress.step} was done: the axes are at its goal", True
        if near(progress.pending.start):
            return f"the move of step {progress.step} was not made: the axes are where they were", False
        return f"the move of step {progress.step} was broken off, {off(goal)} before its goal", False
    if near(progress.position):
        return "the axes are where they were left", progress.arrived
    return (
        f"the axes stand {off(progress.position)} from where they were left: somebody moved them",
        progress.arrived and near(goal),
    )
