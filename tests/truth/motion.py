"""What a machine lives through: its commands in time and the conditions around it, as the laws of its faults see
them.
"""

from dataclasses import dataclass

import numpy as np

from tests.truth.journey import Journey
from tests.truth.kinematics import Machine

EVERY = 5.0  # s between rows of the sensors' log
REFERENCE = 20.0  # C at which lengths are stated


@dataclass(frozen=True)
class Conditions:
    """Of a day, from t = 0 on. room : (start C, drift C, wave C, period s, span s); warmer : (axes,) C that each axis
    gets warmer than the room
    loads : (m, 2) from t s on, kg; a payload's mass"""

    room: tuple[float, float, float, float, float]
    warmer: np.ndarray
    loads: np.ndarray

    def room_at(self, t: np.ndarray) -> np.ndarray:
        """(n,) C of the room."""
        start, drift, wave, period, span = self.room
        return start + drift * t / span + wave * np.sin(2 * np.pi * t / period)

    def axes_at(self, t: np.ndarray) -> np.ndarray:
        """(n, axes) C of the axes, as their sensors have it."""
        return self.room_at(t)[:, None] + self.warmer * (1 - np.exp(-t / (0.4 * self.room[4])))[:, None]

    def load_at(self, t: np.ndarray) -> np.ndarray:
        """(n,) kg of payload."""
        return self.loads[np.searchsorted(self.loads[:, 0], t, side="right") - 1, 1]


@dataclass(frozen=True)
class Motion:
    """t, values : (k,) s, (k, axes) everything the machine passes; at : (n,) indices of what is looked at;
    day : Conditions
    machine : as it really is"""

    t: np.ndarray
    values: np.ndarray
    at: np.ndarray
    day: Conditions
    machine: Machine

    @property
    def looked(self) -> np.ndarray:
        """(n,) s."""
        return self.t[self.at]

    @property
    def home(self) -> np.ndarray:
        """(axes,) middle of the travels."""
        return self.machine.ranges.mean(axis=1)


def passed(path: Journey, looked: np.ndarray, day: Conditions, machine: Machine) -> Motion:
    """Motion of a Journey, looked at at times (n,) s."""
    t = np.union1d(path.t, looked)
    return Motion(t, path.at(t), np.searchsorted(t, looked), day, machine)
