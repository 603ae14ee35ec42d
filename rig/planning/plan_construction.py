"""A plan being written: where the struts go and when, what is exposed, what the platform carries."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.planning.approach_balance import balanced_approaches, balanced_order
from rig.recording.recording_folder import Commands
from rig.recording.time_origin import Origin

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
    t: np.ndarray
    payload: np.ndarray
    origin: Origin = Origin()
    turned: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """How configurations are approached. strokes : (axes, 2) m or rad, which are not left; below : (axes,) m or rad
    from which every axis always comes up, where the plan is one-sided, else None; rng : numpy Generator, for order and
    sides"""

    strokes: np.ndarray
    below: np.ndarray | None
    rng: np.random.Generator


class Writer:
    """A plan being written: where the struts are, when, and what has been exposed. approach : of configurations, None
    for straight ways
    """

    def __init__(self, start: np.ndarray, speed: float | np.ndarray, approach: Approach | None = None) -> None:
        self.t, self.values, self.payload = [0.0, 1.0], [start, start], [(0.0, 0.0)]
        self.exposures: list[float] = []
        self.turned: dict[str, int] = {}
        self.speed, self.approach = speed, approach

    def go(self, goal: np.ndarray) -> None:
        """Go there as fast as the plan goes (axes,) m or rad."""
        seconds = float((np.abs(goal - self.values[-1]) / self.speed).max())
        if seconds > 0:
            self.t.append(self.t[-1] + max(seconds, STEP))
            self.values.append(goal)

    def dwell(self, seconds: float) -> None:
        """Stay for so long (s)."""
        self.t.append(self.t[-1] + seconds)
        self.values.append(self.values[-1])

    def settle(self, goal: np.ndarray, last: np.ndarray | None = None) -> None:
        """Go there, dwell, expose once settled. last : (axes,) m or rad by which each axis moves last, None straight;
        where the plan is one-sided every axis comes from below"""
        if self.approach is not None and self.approach.below is not None:
            last = self.approach.below
        if last is not None:
            self.go(goal - last)
        self.go(goal)
        self.dwell(DWELL + AFTER)
        self.exposures.append(self.t[-1] - AFTER)

    def visit(self, goals: np.ndarray) -> None:
        """Settle at each of the configurations (n, axes), in an order and from sides that are no function of place (see
        rig.planning.approach_balance)."""
        self.follow(self.shuffled(goals))

    def follow(self, goals: np.ndarray) -> None:
        """Settle at each of the configurations (n, axes) in their order, from sides that are no function of place."""
        for goal, last in zip(goals, self.approaches(goals)):
            self.settle(goal, last)

    def shuffled(self, goals: np.ndarray) -> np.ndarray:
        """Configurations (n, axes) in an order in which time is no function of place."""
        return np.asarray(goals)[balanced_order(goals, self._sided().rng)]

    def approaches(self, goals: np.ndarray, others: Sequence[np.ndarray] = ()) -> np.ndarray:
        """(n, axes) m or rad, last moves to configurations in their order, whose sides are no function of place, time
        and others (n,).
        """
        approach = self._sided()
        return balanced_approaches(goals, approach.rng, approach.strokes, others)

    def _sided(self) -> Approach:
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
