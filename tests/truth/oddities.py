"""Laws that no catalogue has: heat of a screw's own friction, loops of odd shapes, odd laws of heat and place."""

from dataclasses import dataclass

import numpy as np

from tests.truth.laws import Law
from tests.truth.motion import Motion

STEP = 0.5  # s, of the differential equations of heat


@dataclass(frozen=True)
class FrictionHeat(Law):
    """A screw is heated by friction that grows with its speed, c' = |v| (1 + |v| / fast) - c / fade - c^2 / much, and
    grows by size * (c / much) ** bend. fade : s; fast : m/s; much : m of travel
    """

    size: float
    fade: float
    fast: float
    much: float
    bend: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        t = np.arange(0.0, motion.looked.max() + 2 * STEP, STEP)
        course = np.stack([np.interp(t, motion.t, column) for column in motion.values.T], axis=1)
        speed = np.abs(np.diff(course, axis=0)) / STEP
        heat = np.zeros(course.shape)
        for k, v in enumerate(speed):
            c = heat[k]
            heat[k + 1] = c + STEP * (v * (1 + v / self.fast) - c / self.fade - c**2 / self.much / self.fade)
        now = np.stack([np.interp(motion.looked, t, column) for column in heat.T], axis=1)
        return self.axes * self.size * (now / self.much) ** self.bend


@dataclass(frozen=True)
class SlopingGap(Law):
    """Play whose gap is wider at one end of the travel: a worn screw. least, most : m, gaps at the ends"""

    least: float
    most: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        low, high = motion.machine.ranges.T
        values, nut = motion.values, motion.values[0].copy()
        out = np.zeros(values.shape)
        for k, value in enumerate(values):
            half = (self.least + (self.most - self.least) * (value - low) / (high - low)) / 2
            nut = np.clip(nut, value - half, value + half)
            out[k] = nut - value
        return self.axes * out[motion.at]


@dataclass(frozen=True)
class OneSidedLoop(Law):
    """After a reversal an axis is short by size * d^2 / (d^2 + reach^2) going out, and by a part of that going in; d
    the travel since the reversal, m.
    """

    size: float
    reach: float
    part: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        since, sense = np.zeros(motion.values.shape[1]), np.ones(motion.values.shape[1])
        rest, out = np.zeros(motion.values.shape[1]), np.zeros(motion.values.shape)
        for k, step in enumerate(np.diff(motion.values, axis=0), 1):
            turned = step * sense < 0
            rest = np.where(turned, out[k - 1], rest)
            since = np.where(turned, 0.0, since) + np.abs(step)
            sense = np.where(step == 0, sense, np.sign(step))
            goal = np.where(sense > 0, -self.size, self.size * self.part)
            out[k] = rest + (goal - rest) * since**2 / (since**2 + self.reach**2)
        return self.axes * out[motion.at]


@dataclass(frozen=True)
class HeatCurve(Law):
    """An axis grows by an odd curve of its own thermometer: "knee" (a preload that comes off), "turn" (first shorter,
    then longer) or "snap" (a bimetal that gives way). size : m; middle, width : C
    """

    size: float
    middle: float
    width: float
    shape: str

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        x = (motion.day.axes_at(motion.looked) - self.middle) / self.width
        grown = {"knee": np.maximum(x, 0.0), "turn": x**2 - 0.5 * np.abs(x), "snap": np.arctan(4 * x)}[self.shape]
        return self.axes * self.size * grown


@dataclass(frozen=True)
class Dent(Law):
    """A worn place on a screw and a collar beyond it. size : m; place, width : shares of the stroke from its middle"""

    size: float
    place: float
    width: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        share = (motion.values[motion.at] - motion.home) / np.ptp(motion.machine.ranges, axis=1)
        x = (share - self.place) / self.width
        return self.axes * self.size * (np.exp(-(x**2)) - 0.5 / (1 + np.exp(-3 * (x - 1))))


@dataclass(frozen=True)
class Bent(Law):
    """A frame gives with where the platform stands: size * x / (1 + x^2) + size * y |y| of its place from the middle of
    the poses, in shares of `wide` m.
    """

    size: float
    wide: float

    posed = True

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        home = motion.machine.forward(motion.home[None])[0, :3, 3]
        x, y, _ = ((poses[:, :3, 3] - home) / self.wide).T
        return self.axes * self.size * (x / (1 + x**2) + y * np.abs(y))[:, None]


@dataclass(frozen=True)
class Course(Law):
    """An axis moves with the time since it was switched on: "swing" (a regulator that overshoots) or "root" (heat that
    soaks in). size : m; span : s
    """

    size: float
    span: float
    shape: str

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        x = np.maximum(motion.looked, 0.0) / self.span
        moved = {"swing": np.exp(-2 * x) * np.cos(9 * x), "root": np.sqrt(x) * (1 - 0.6 * x)}[self.shape]
        return self.axes * self.size * moved[:, None]
