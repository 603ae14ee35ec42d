"""A plan -> the steps of a run: where the struts go, in which order, and where they stand to be seen; checked before
anything moves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rig.errors import RigError, Unreachable
from rig.planning.plan import Plan

STANDING = 1e-9  # m; commands that differ by less are one place
INSTANT = 1e-6  # s about an exposure in which the struts must not move


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One move and what follows it. goal : (axes,) m; frames : how many exposures are taken there, 0 for a place passed
    on the way.
    """

    goal: np.ndarray
    frames: int


def steps_of_plan(plan: Plan) -> tuple[Step, ...]:
    """Steps of a plan: every place where its commands turn or dwell, and how often it is exposed there.

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
    exposed = np.zeros(len(goals), int)
    for t in plan.t:
        after = min(int(np.searchsorted(plan.commands.t, t + INSTANT, side="left")), len(rows) - 1)
        before = max(int(np.searchsorted(plan.commands.t, t - INSTANT, side="right")) - 1, 0)
        if place[after] != place[before]:
            raise RigError(
                f"the plan exposes at t = {t:g} s while the struts move; a run exposes where they stand "
                "(leave out moving and zigzag)"
            )
        exposed[place[before]] += 1
    last = np.flatnonzero(exposed)[-1]
    return tuple(Step(goal, int(count)) for goal, count in zip(goals[: last + 1], exposed))


def check_steps(
    planned: tuple[Step, ...], start: np.ndarray, check_move: Callable[[np.ndarray, np.ndarray], None]
) -> None:
    """Check every place and every path between, from start (axes,) m on, before anything moves.

    check_move : (start, goal) -> None, raises RigError where the move may not be made. Raises Unreachable listing all
        that may not.
    """
    refused, at = [], start
    for k, step in enumerate(planned):
        try:
            check_move(at, step.goal)
        except RigError as error:
            refused.append((k, f"step {k}: {error}"))
        at = step.goal
    if refused:
        raise Unreachable(
            f"{len(refused)} of {len(planned)} moves of the plan cannot be made; nothing has moved:",
            [k for k, _ in refused],
            [line for _, line in refused],
        )


def step_distances(planned: tuple[Step, ...], start: np.ndarray) -> np.ndarray:
    """(steps,) m, how far the strut with the longest way goes in each step."""
    goals = np.array([start, *(step.goal for step in planned)])
    return np.abs(np.diff(goals, axis=0)).max(axis=1)
