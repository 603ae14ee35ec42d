"""How far a run has come by its journal, and what the position read after a crash says of the move that was under
way.
"""

from dataclasses import dataclass

import numpy as np

from rig.driving.run_journal import Arrival, Began, Departure, Ended, Exposed, Readings, Remark, Resumed, Row
from rig.driving.run_steps import Step
from rig.errors import RigError


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """step : index of the one that is under way or next; frames : exposures taken at it; number : of the next frame
    position : (axes,) m, where the struts were last known to stand; pending : the Departure that has no arrival, or
        None
    arrived : whether they stand at the step's goal; t : s of the last row; ended : why the run ended, None while it has
        not"""

    step: int
    frames: int
    number: int
    position: np.ndarray
    pending: Departure | None
    arrived: bool
    t: float
    ended: str | None


def run_progress(rows: list[Row], planned: tuple[Step, ...]) -> Progress:
    """Progress of a journal's rows. Raises RigError for rows that no run of this plan leaves."""
    if not rows or not isinstance(rows[0], Began):
        raise RigError("the journal holds no beginning of a run")
    if rows[0].steps != len(planned):
        raise RigError(f"the journal is of a plan of {rows[0].steps} steps, this one has {len(planned)}")
    step = frames = number = 0
    pending, arrived, ended, position = None, False, None, np.array(rows[0].position)
    for row in rows:
        ended = row.reason if isinstance(row, Ended) else None if not isinstance(row, Remark | Readings) else ended
        if isinstance(row, Departure):
            if row.step != step:  # the one before was done
                if row.step != step + 1 or frames < planned[step].frames:
                    raise RigError(
                        f"the journal leaves step {step} with {frames} of {planned[step].frames} frames for "
                        f"step {row.step}"
                    )
                step, frames = row.step, 0
            pending, arrived, position = row, False, np.array(row.start)
        elif isinstance(row, Arrival):
            pending, arrived, position = None, row.reached, np.array(row.position)
        elif isinstance(row, Resumed):
            position = np.array(row.position)
            arrived = arrived and bool(np.abs(position - planned[step].goal).max() <= 0)
        elif isinstance(row, Exposed):
            frames, number = frames + 1, row.frame + 1
    return Progress(step, frames, number, position, pending, arrived, rows[-1].t, ended)


def move_verdict(
    state: Progress, planned: tuple[Step, ...], position: np.ndarray, tolerance: float
) -> tuple[str, bool]:
    """(what a position (axes,) m, read after a crash, says, in words; whether the step's goal is where the struts
    stand).

    tolerance : m, of a read-back
    """

    def near(place: object) -> bool:
        return bool(np.abs(position - np.asarray(place)).max() <= tolerance)

    def off(place: object) -> str:
        return f"{np.abs(position - np.asarray(place)).max() * 1e3:.3f} mm"

    goal = planned[state.step].goal
    if state.pending is not None:
        if near(goal):
            return f"the move of step {state.step} was done: the struts stand at its goal", True
        if near(state.pending.start):
            return f"the move of step {state.step} was not made: the struts stand where they were", False
        return f"the move of step {state.step} was broken off, {off(goal)} before its goal", False
    if near(state.position):
        return "the struts stand where they were left", state.arrived
    return (
        f"the struts stand {off(state.position)} from where they were left: somebody moved them",
        state.arrived and near(goal),
    )
