"""Faults with a memory of the path: play, friction with springs, creep, lag, the last step."""

from dataclasses import dataclass

import numpy as np

from tests.truth.laws import Law
from tests.truth.motion import Motion


@dataclass(frozen=True)
class Stops(Law):
    """Play between two stops: the driver floats between `short` (m ahead, outward) and `long` (inward); begun : (axes,)
    -1..1 in the gap.
    """

    short: float
    long: float
    begun: np.ndarray

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        ahead = np.where(self.begun > 0, self.short * self.begun, self.long * self.begun)
        out = np.empty(motion.values.shape)
        out[0] = ahead
        for k, step in enumerate(np.diff(motion.values, axis=0), 1):
            ahead = np.clip(ahead + step, -self.long, self.short)
            out[k] = ahead
        return -self.axes * out[motion.at]


@dataclass(frozen=True)
class Bristles(Law):
    """Bristles that bend and slip (Dahl; Bouc-Wen of order 1): z' = 1 - share z sign(dx) / most - (1 - share) |z| /
    most.

    most : (m,) greatest bends; weights : (m,) of each set of bristles; share : of Bouc-Wen's beta, 1 is Dahl's. The
        axis stays short by weights @ z
    """

    most: np.ndarray
    weights: np.ndarray
    share: float
    begun: np.ndarray

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        z = self.most[:, None] * 0.5 * self.begun
        out = np.empty(motion.values.shape)
        out[0] = self.weights @ z
        for k, step in enumerate(np.diff(motion.values, axis=0), 1):
            z = self._moved(z, step)
            out[k] = self.weights @ z
        return -self.axes * out[motion.at]

    def _moved(self, z: np.ndarray, step: np.ndarray) -> np.ndarray:
        """z (m, axes) after a step (axes,): along y = z sign(step), y' = 1 - share y / most - (1 - share) |y| / most,
        in closed form.
        """
        sign, far = np.sign(step), np.abs(step)[None] + np.zeros_like(z)
        y, most = z * sign, self.most[:, None]
        slow = (2 * self.share - 1) / most  # where y < 0: y' = 1 - slow y
        with np.errstate(divide="ignore", invalid="ignore"):
            to_zero = np.where(y < 0, np.log1p(-slow * y) / slow if self.share != 0.5 else -y, 0.0)
        left = np.maximum(far - to_zero, 0.0)
        inside = np.minimum(far, to_zero)
        if self.share != 0.5:
            below = 1 / slow + (y - 1 / slow) * np.exp(-slow * inside)
        else:
            below = y + inside
        y = np.where((y < 0) & (left == 0), below, np.maximum(y, 0.0))
        y = np.where(left > 0, most + (y - most) * np.exp(-left / most), y)
        return np.where(step == 0, z, y * sign)


@dataclass(frozen=True)
class Sliders(Law):
    """Springs in parallel with sliders (Maxwell, Iwan): each holds at most its own reach of travel. reach,
    weights : (m,) m and shares.
    """

    reach: np.ndarray
    weights: np.ndarray
    begun: np.ndarray

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        held = self.reach[:, None] * self.begun
        out = np.empty(motion.values.shape)
        out[0] = self.weights @ held
        for k, step in enumerate(np.diff(motion.values, axis=0), 1):
            force = held + step
            held = np.sign(force) * np.minimum(np.abs(force), self.reach[:, None])
            out[k] = self.weights @ held
        return -self.axes * out[motion.at]


@dataclass(frozen=True)
class Late(Law):
    """Part of each move comes late; `area(s)` s is the integral over s seconds of the share that is still missing, 1 at
    first.
    """

    fraction: float

    def area(self, s: np.ndarray) -> np.ndarray:
        """(...) s, of ages s (...)."""
        raise NotImplementedError

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        pace = np.diff(motion.values, axis=0) / np.diff(motion.t)[:, None]
        out = np.zeros((len(motion.at), motion.values.shape[1]))
        for row, k in enumerate(motion.at):
            out[row] = -np.diff(self.area(motion.t[k] - motion.t[: k + 1])) @ pace[:k]
        return -self.axes * self.fraction * out


@dataclass(frozen=True)
class TwoPaces(Late):
    """Two relaxations: fast and slow s, and the share of the fast one."""

    fast: float
    slow: float
    share: float

    def area(self, s: np.ndarray) -> np.ndarray:
        return -self.share * self.fast * np.expm1(-s / self.fast) - (1 - self.share) * self.slow * np.expm1(
            -s / self.slow
        )


@dataclass(frozen=True)
class Logarithmic(Late):
    """Creep with the logarithm of time, from `first` to `last` s: 1 - log(1 + s / first) / log(1 + last / first)."""

    first: float
    last: float

    def area(self, s: np.ndarray) -> np.ndarray:
        x, whole = np.minimum(s, self.last) / self.first, np.log1p(self.last / self.first)
        return self.first * (x - ((1 + x) * np.log1p(x) - x) / whole)


@dataclass(frozen=True)
class Damped(Late):
    """A drive of the second order that follows its command: natural frequency rad/s, damping below 1; fraction 1 is the
    drive itself.
    """

    frequency: float
    damping: float

    def area(self, s: np.ndarray) -> np.ndarray:
        root = np.sqrt(1 - self.damping**2)
        pole = self.frequency * (-self.damping + 1j * root)
        return np.real((1 - 1j * self.damping / root) * np.expm1(pole * s) / pole)


@dataclass(frozen=True)
class LastStep(Law):
    """An axis stops short by a part of its last step, part grown or not with the step's own length. fraction;
    bend : 1/unit of travel
    """

    fraction: float
    bend: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        last = np.zeros(motion.values.shape)
        begun = motion.values[0].copy()
        resting = True
        for k, step in enumerate(np.diff(motion.values, axis=0), 1):
            if np.any(step) and resting:
                begun = motion.values[k - 1]
            resting = not np.any(step)
            last[k] = motion.values[k] - begun
        last = last[motion.at]
        return -self.axes * self.fraction * last * (1 + self.bend * np.abs(last))
