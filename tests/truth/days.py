"""Faults of heat and time: expansion, warming up, growing plates, lost steps, shaking, clocks."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tests.truth.kinematics import Arm, Hinge, SixStruts
from tests.truth.laws import Law
from tests.truth.motion import REFERENCE, Motion
from tests.truth.rigid import errors


@dataclass(frozen=True)
class Heated(Law):
    """Axes grow with what is inside them, which follows the logged surface with a delay. per_kelvin : 1/K; delay : s
    (0: the log itself)
    """

    per_kelvin: float
    delay: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        assert isinstance(motion.machine, SixStruts | Hinge)
        if self.delay == 0:
            warm = motion.day.axes_at(motion.looked)
        else:
            t = np.arange(0.0, motion.looked.max() + 2, min(1.0, self.delay / 20))
            skin = motion.day.axes_at(t)
            core = np.empty_like(skin)
            core[0] = skin[0]
            pull = 1 - np.exp(-(t[1] - t[0]) / self.delay)
            for k in range(1, len(t)):
                core[k] = core[k - 1] + pull * (skin[k] - core[k - 1])
            warm = np.stack([np.interp(motion.looked, t, column) for column in core.T], axis=1)
        return self.axes * self.per_kelvin * (motion.values[motion.at] + motion.machine.zeros) * (warm - REFERENCE)


@dataclass(frozen=True)
class GrownLinks(Law):
    """An arm's links, and what carries them, grow with the room: every length of its rows by per_kelvin, 1/K."""

    per_kelvin: float

    def sway(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        arm = motion.machine
        assert isinstance(arm, Arm)
        little = 1e-4
        values = motion.values[motion.at]
        grown = replace(arm, rows=arm.rows * (1 + little * np.array([0, 1, 1, 0]))).forward(values)
        slope = errors(grown, arm.forward(values)) / little
        return slope * self.per_kelvin * (motion.day.room_at(motion.looked) - REFERENCE)[:, None]


@dataclass(frozen=True)
class Warming(Law):
    """Growth after switching on, two bodies heated one through the other. size : m in the end; first, second : s;
    share : of the first alone
    """

    size: float
    first: float
    second: float
    share: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        t, a, b = motion.looked, self.first, self.second
        behind = 1 - (b * np.exp(-t / b) - a * np.exp(-t / a)) / (b - a)
        return self.axes * self.size * (self.share * (1 - np.exp(-t / a)) + (1 - self.share) * behind)[:, None]


@dataclass(frozen=True)
class GrowingBase(Law):
    """The base plate grows with the room. per_kelvin : (3,) 1/K along x, y, z; what the struts miss by it is solved
    with the pose.
    """

    per_kelvin: np.ndarray

    posed = True

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        legs = motion.machine.legs(poses)
        warm = motion.day.room_at(motion.looked) - REFERENCE
        moved = legs - warm[:, None, None] * self.per_kelvin * motion.machine.base
        return np.linalg.norm(legs, axis=2) - np.linalg.norm(moved, axis=2)


@dataclass(frozen=True)
class Lost(Law):
    """Steps lost at moments, until the machine is homed. moments, sizes : (m,) s and m"""

    moments: np.ndarray
    sizes: np.ndarray

    def later(self) -> Self:
        return replace(self, sizes=0 * self.sizes)  # the axes are homed

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        return self.axes * ((motion.looked[:, None] > self.moments) @ self.sizes)[:, None]


@dataclass(frozen=True)
class Shaken(Law):
    """The platform shakes. mode : (m, 6) tangents; rates : (m,) Hz; phases : (m,) rad"""

    mode: np.ndarray
    rates: np.ndarray
    phases: np.ndarray

    def sway(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * motion.looked[:, None] * self.rates + self.phases) @ self.mode


@dataclass(frozen=True)
class Clocked(Law):
    """Exposures are really `offset` s later than logged, and by `rate` more each second."""

    offset: float
    rate: float

    def clock(self, t: np.ndarray) -> np.ndarray:
        return t + self.offset + self.rate * t
