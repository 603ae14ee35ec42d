"""Faults of force: struts that give, joints with clearance, under the weight of platform and payload in static
balance.
"""

from dataclasses import dataclass

import numpy as np

from tests.truth.laws import Law
from tests.truth.motion import Motion

GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Weighed(Law):
    """mass : kg; centre, payload : (3,) m in the platform's frame, of the platform and of what it carries."""

    mass: float
    centre: np.ndarray
    payload: np.ndarray

    posed = True

    def forces(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        """(n, 6) N with which struts push the platform: sum f u = -weight, sum f (r x u) = -moment about the platform's
        origin.
        """
        carried = motion.day.load_at(motion.looked)
        turned = poses[:, :3, :3]
        weight = (self.mass + carried)[:, None] * GRAVITY
        moment = np.cross(turned @ self.centre, self.mass * GRAVITY) + np.cross(
            turned @ self.payload, carried[:, None] * GRAVITY
        )
        return np.linalg.solve(
            np.swapaxes(motion.machine.rates(poses), 1, 2), -np.concatenate([weight, moment], axis=1)[..., None]
        )[..., 0]


@dataclass(frozen=True)
class Springs(Weighed):
    """Struts of stiffness N/m that stiffen: compressed by f / stiffness / (1 + |f| / stiffening N); infinite stiffening
    is a plain spring.
    """

    stiffness: float
    stiffening: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        force = self.forces(motion, poses)
        return -self.axes * force / self.stiffness / (1 + np.abs(force) / self.stiffening)


@dataclass(frozen=True)
class Loose(Weighed):
    """Joints with a clearance of `gap` m on which they lie the way the force points; soft : N over which they change
    sides (0: at once).
    """

    gap: float
    soft: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        force = self.forces(motion, poses)
        side = np.sign(force) if self.soft == 0 else np.tanh(force / self.soft)
        return -self.axes * self.gap / 2 * side
