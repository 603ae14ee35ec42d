"""Effects of the catalogue by other formulas, so that a recording of them holds nothing of the catalogue's own code.

The place, the numbers and what they mean are those of the effect of the same name.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion

SMALL = 0.02  # s, step of an integration by small steps
PLATE, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])  # a cardan's first axis, the strut at rest


@dataclass(frozen=True, slots=True)
class SwungCardan(Effect):
    """A cardan of two rotation matrices, the second's axis offset m up the strut; Newton's method finds its two angles
    and the strut's length from where the other joint is."""

    place: str
    offset: float = 0.0
    end: float = 0.0
    name: ClassVar = "swung_cardan"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    on_pose: ClassVar = True

    def deviation(self, motion: Motion) -> Floats:
        m, strut = motion.mechanism, int(self.place.split()[1]) - 1
        lengths = []
        for T in (motion.poses(), m.home):
            near, far = m.base_joints[strut], T.apply(m.platform_joints[strut])
            if self.end:  # seen from the platform
                near, far = m.platform_joints[strut], T.inv().apply(m.base_joints[strut])
            tangent = np.array([-near[1], near[0], 0.0])
            up = UP if not self.end else -UP
            frame = np.stack([tangent, np.cross(up, tangent), up * np.linalg.norm(tangent)], axis=1)
            arm = (np.atleast_2d(far) - near) @ frame / np.linalg.norm(tangent)
            lengths.append(np.linalg.norm(arm, axis=1) - self._length(arm))
        out = np.zeros(motion.lengths.shape)
        out[:, strut] = lengths[0] - lengths[1]
        return out

    def _length(self, arm: Floats) -> Floats:
        """(n,) m from the second axis to the other joint, which is at arm (n, 3) m along plate axis, across, and up."""
        guess = np.column_stack([np.zeros((len(arm), 2)), np.linalg.norm(arm, axis=1)])

        def reached(x: Floats) -> Floats:
            first = Rotation.from_rotvec(x[:, :1] * PLATE)
            second = Rotation.from_rotvec(x[:, 1:2] * np.array([0.0, 1.0, 0.0]))
            return first.apply(self.offset * UP + second.apply(x[:, 2:] * UP))

        for _ in range(30):
            off = reached(guess) - arm
            steps = 1e-6 * np.eye(3)
            J = np.stack([(reached(guess + h) - reached(guess - h)) / 2e-6 for h in steps], axis=2)
            guess = guess - np.linalg.solve(J, off[..., None])[..., 0]
        return guess[:, 2]


@dataclass(frozen=True, slots=True)
class WarmedScrew(Effect):
    """A screw's temperature by Euler's small steps along the path: it takes in its travel and gives back its share."""

    place: str
    per_metre: float = 0.0
    time_constant: float = 600.0
    name: ClassVar = "warmed_screw"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)

    def deviation(self, motion: Motion) -> Floats:
        path, axis = motion.path, motion.places.index(self.place)
        t = np.union1d(np.arange(path.t[0], path.t[-1], SMALL), path.t)
        travel = np.abs(np.diff(np.interp(t, path.t, path.lengths[:, axis])))
        warm, course = 0.0, [0.0]
        for step, dt in zip(travel.tolist(), np.diff(t).tolist()):
            warm += step - warm * dt / self.time_constant
            course.append(warm)
        out = np.zeros(motion.lengths.shape)
        out[:, axis] = self.per_metre * np.interp(motion.t, t, course)
        return out


@dataclass(frozen=True, slots=True)
class OffsetSignals(Effect):
    """A scale's sine and cosine are read with an offset (shares of their size) and turned into a place by their angle;
    the strut stops where the place that is read is the one commanded."""

    place: str
    pitch: float
    offset: tuple[float, float]
    name: ClassVar = "offset_signals"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)

    def deviation(self, motion: Motion) -> Floats:
        axis = motion.places.index(self.place)
        wanted = 2 * np.pi * (motion.lengths - motion.home)[:, axis] / self.pitch
        stands = wanted.copy()
        for _ in range(60):
            read = np.arctan2(np.sin(stands) + self.offset[1], np.cos(stands) + self.offset[0])
            stands -= 0.8 * ((read - wanted + np.pi) % (2 * np.pi) - np.pi)
        out = np.zeros(motion.lengths.shape)
        out[:, axis] = (stands - wanted) * self.pitch / (2 * np.pi)
        return out
