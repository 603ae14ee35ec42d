"""Faults that depend on where the axes stand alone: scale, periods, profiles, one axis' travel in another, twist of
screws.
"""

from dataclasses import dataclass

import numpy as np

from tests.truth.laws import Law
from tests.truth.motion import Motion


@dataclass(frozen=True)
class Scaled(Law):
    """share of the travel from home, and `bow` 1/unit of its square."""

    share: float
    bow: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        travel = motion.values[motion.at] - motion.home
        return self.axes * (self.share * travel + self.bow * travel**2)


@dataclass(frozen=True)
class Periodic(Law):
    """Sines of the axis' own place. pitch : unit of travel; sizes, phases : (m,) of orders 1.."""

    pitch: float
    sizes: np.ndarray
    phases: np.ndarray

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        turns = motion.values[motion.at][..., None] * (np.arange(len(self.sizes)) + 1) / self.pitch
        return self.axes * (np.sin(2 * np.pi * turns + self.phases) @ self.sizes)


@dataclass(frozen=True)
class Sawtooth(Law):
    """An even zigzag of the axis' own place, as of an eccentric gear with a flat. size : from zero to a tip; pitch;
    phase : of a period
    """

    size: float
    pitch: float
    phase: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        turns = motion.values[motion.at] / self.pitch + self.phase
        return self.axes * self.size * (4 * np.abs(turns - np.floor(turns) - 0.5) - 1)


@dataclass(frozen=True)
class Waves(Law):
    """A screw's profile: sines of a few travels' length, a drift on top. sizes, waves, phases : (m,) waves in strokes;
    drift : over the stroke
    """

    sizes: np.ndarray
    waves: np.ndarray
    phases: np.ndarray
    drift: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        share = (motion.values[motion.at] - motion.home) / np.ptp(motion.machine.ranges, axis=1)
        return self.axes * (
            np.sin(2 * np.pi * share[..., None] / self.waves + self.phases) @ self.sizes + self.drift * share
        )


@dataclass(frozen=True)
class Kinked(Law):
    """A profile of straight parts between nodes (m,) spread over the stroke; heights : (m,)."""

    heights: np.ndarray

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        share = (motion.values[motion.at] - motion.home) / np.ptp(motion.machine.ranges, axis=1) + 0.5
        return self.axes * np.interp(share, np.linspace(0, 1, len(self.heights)), self.heights)


@dataclass(frozen=True)
class Coupled(Law):
    """Part of another axis' travel. other : its index; share; bow : 1/unit, of the square."""

    other: int
    share: float
    bow: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        travel = (motion.values[motion.at] - motion.home)[:, self.other]
        return self.axes * (self.share * travel + self.bow * travel**2)[:, None]


@dataclass(frozen=True)
class Twisted(Law):
    """A screw's nut turns with the platform-side cardan against the base-side one. lead : m/rev; gain : of it, and
    `more` of its square (1/rad).
    """

    lead: float
    gain: float
    more: float

    posed = True

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        home = motion.machine.forward(motion.home[None])
        turn = self._turn(motion, poses) - self._turn(motion, home)
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        return self.axes * self.lead / (2 * np.pi) * (self.gain * turn + self.more * turn**2)

    @staticmethod
    def _turn(motion: Motion, poses: np.ndarray) -> np.ndarray:
        """(n, 6) rad about the strut from the base's cross to the platform's, by the angle of each second axis in a
        plane square to the strut.
        """
        machine = motion.machine
        legs = machine.legs(poses)
        u = legs / np.linalg.norm(legs, axis=2, keepdims=True)
        angle = []
        frame = np.cross(u, np.array([0.36, 0.48, 0.8]))  # any vector square to u measures both
        frame /= np.linalg.norm(frame, axis=2, keepdims=True)
        for joints, turned in ((machine.base, np.eye(3)[None]), (machine.plate, poses[:, :3, :3])):
            tangent = np.stack([-joints[:, 1], joints[:, 0], np.zeros(6)], axis=1)
            second = np.cross(np.einsum("nij,kj->nki", turned, tangent), u)
            angle.append(np.arctan2((np.cross(frame, second) * u).sum(axis=2), (frame * second).sum(axis=2)))
        return angle[1] - angle[0]
