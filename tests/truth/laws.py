"""What a law of a fault may do to a machine, and how a machine with laws is driven in time."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from tests.truth.journey import Journey
from tests.truth.kinematics import Machine
from tests.truth.motion import Conditions, Motion, passed
from tests.truth.rigid import displaced


@dataclass(frozen=True)
class Law:
    """A fault. Subclasses override what they do; axes : (axes,) share of it that each axis has."""

    axes: np.ndarray

    posed = False  # whether its lengths depend on where the platform stands

    def later(self) -> Self:
        """The law on the days after the recording."""
        return self

    def clock(self, t: np.ndarray) -> np.ndarray:
        """(n,) s on the commands' clock of exposures logged at t (n,) s."""
        return t

    def followed(self, motion: Motion) -> np.ndarray:
        """(k, axes) where the axes are driven in place of the commands."""
        return motion.values

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        """(n, axes) by which axes stand beyond their commands, at poses (n, 4, 4)."""
        return np.zeros((len(motion.at), motion.values.shape[1]))

    def sway(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        """(n, 6) small motion of the platform on top, in its own frame."""
        return np.zeros((len(motion.at), 6))


def stood(
    machine: Machine, path: Journey, day: Conditions, laws: tuple[Any, ...], looked: np.ndarray | None = None
) -> np.ndarray:
    """(n, 4, 4) poses at which a machine with laws stands when looked at at (n,) s, a Journey's own times by default.

    Raises ArithmeticError where lengths and poses that depend on each other come to no rest.
    """
    looked = path.looked if looked is None else looked
    for law in laws:
        looked = law.clock(looked)
    motion = passed(path, looked, day, machine)
    for law in laws:
        motion = replace(motion, values=law.followed(motion))
    poses = machine.forward(motion.values[motion.at])
    for _ in range(60):
        lengths = motion.values[motion.at] + sum(
            (law.beyond(motion, poses) for law in laws), np.zeros((len(looked), machine.width))
        )
        after = machine.forward(lengths)
        moved, poses = np.abs(after - poses).max(), after
        if moved < 1e-12 or not any(law.posed for law in laws):
            return displaced(poses, sum((law.sway(motion, poses) for law in laws), np.zeros((len(looked), 6))))
    raise ArithmeticError(f"lengths and poses come to no rest: {moved:.3g} m after 60 rounds")
