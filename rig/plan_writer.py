"""A plan being written: where the struts go and when, what is exposed, what the platform carries."""

from dataclasses import dataclass

import numpy as np

from rig.origin import Origin
from rig.recording import Commands

DWELL = 2.0  # s at a configuration before its exposure
AFTER = 1.0  # s at it after the exposure
STEP = 0.05  # s between command rows while moving
FIRST = 0.5  # s from a move's end to the first exposure of a long dwell


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """commands : Commands; t : (frames,) s, the exposures; payload : (k, 2) s and kg, steps of what the platform carries
    origin : by which its times are written down
    turned : (cube, quarter turns) of cubes that are put back so before it begins; others stand as they stood"""

    commands: Commands
    t: np.ndarray
    payload: np.ndarray
    origin: Origin = Origin()
    turned: tuple[tuple[str, int], ...] = ()


class Writer:
    """A plan being written: where the struts are, when, and what has been exposed."""

    def __init__(self, start: np.ndarray, speed: float | np.ndarray, below: float | np.ndarray = 0.0) -> None:
        self.t, self.values, self.payload = [0.0, 1.0], [start, start], [(0.0, 0.0)]
        self.exposures: list[float] = []
        self.turned: dict[str, int] = {}
        self.speed, self.below = speed, below

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

    def settle(self, goal: np.ndarray) -> None:
        """Go there, from below where that is asked for, dwell, expose once settled."""
        if np.any(self.below):
            self.go(goal - self.below)
        self.go(goal)
        self.dwell(DWELL + AFTER)
        self.exposures.append(self.t[-1] - AFTER)

    def watch(self, count: int, seconds: float) -> None:
        """Stay for so long (s), and expose so often meanwhile: often at first, when what comes late moves fastest."""
        start = self.t[-1]
        self.exposures += (start + np.geomspace(FIRST, seconds, count)).tolist()
        self.dwell(seconds + AFTER)

    def plan(self) -> Plan:
        """What was written so far, exposures in order of time."""
        order = np.argsort(self.exposures)
        return Plan(Commands(np.round(self.t, 4), np.round(self.values, 7)), np.round(np.array(self.exposures)[order], 4), np.round(self.payload, 4),
                    turned=tuple(self.turned.items()))
