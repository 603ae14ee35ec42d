"""A loose joint settles on one side or the other, as the strut pushes or pulls."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter
from rig.effects.kinetics import axial_forces


@dataclass(frozen=True, slots=True)
class JointClearance(Effect):
    """Deviation -gap / 2 * sign(f), f > 0 where the strut pushes the platform."""

    place: str
    gap: float = 0.0
    name: ClassVar = "joint_clearance"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("gap", "m", (0, 1e-3), (5e-6, 1.2e-4)),)
    experiment: ClassVar = "poses or payloads in which that strut changes from pushing to pulling"
    on_pose: ClassVar = True

    def deviation(self, motion):
        return -self.struts() * self.gap / 2 * np.sign(axial_forces(motion))
