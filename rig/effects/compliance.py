"""Struts give under load, in static equilibrium."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter
from rig.effects.kinetics import axial_forces


@dataclass(frozen=True, slots=True)
class Compliance(Effect):
    """Deviation -f / stiffness: a strut that pushes is compressed and shorter. Infinite stiffness gives nothing."""

    place: str
    stiffness: float = np.inf
    name: ClassVar = "compliance"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "strut")
    parameters: ClassVar = (Parameter("stiffness", "N/m", (1e4, np.inf), (1e6, 1e8), role="inverse"),)
    experiment: ClassVar = "change the payload: at constant load most of the sag hides in the joint geometry"
    on_pose: ClassVar = True

    def deviation(self, motion):
        return -self.struts() * axial_forces(motion) / self.stiffness
