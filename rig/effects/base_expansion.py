"""The base plate grows with the room: its joints move outward."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import REFERENCE_TEMPERATURE, Effect, Parameter


@dataclass(frozen=True, slots=True)
class BaseExpansion(Effect):
    """Base joints times 1 + coefficient * (T_ambient - 20 C), as what each strut's length seems to lack at the pose."""

    place: str
    coefficient: float = 0.0
    name: ClassVar = "base_expansion"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    parameters: ClassVar = (Parameter("coefficient", "1/K", (-1e-3, 1e-3), (1e-5, 1e-4)),)
    experiment: ClassVar = "the same poses in a cold and a warm room"
    on_pose: ClassVar = True

    def deviation(self, motion):
        scale = 1 + self.coefficient * (motion.channel("ambient_temperature_C") - REFERENCE_TEMPERATURE)
        matrix, m = motion.T.as_matrix(), motion.mechanism
        tips = m.platform_joints @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]
        moved = np.linalg.norm(tips - scale[:, None, None] * m.base_joints, axis=2)
        return np.linalg.norm(tips - m.base_joints, axis=2) - moved
