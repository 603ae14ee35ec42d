"""Error periodic in the screw: it comes back with every turn."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter
from rig.errors import RigError


@dataclass(frozen=True, slots=True)
class CyclicError(Effect):
    """Deviation amplitude * sin(2 pi order l / lead + phase), l the commanded length, lead the screw's."""

    place: str
    amplitude: float = 0.0
    phase: float = 0.0
    order: float = 1.0
    name: ClassVar = "cyclic_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("amplitude", "m", (0, 5e-4), (2e-6, 3e-5)), Parameter("phase", "rad", (-7, 7), (-3.1416, 3.1416), role="phase"),
                            Parameter("order", "", (0.05, 20), (1, 2), role="even"))
    experiment: ClassVar = "steps that are no whole part of the pitch, over several turns of one screw"

    def deviation(self, motion):
        if motion.actuator.screw_lead is None:
            raise RigError("cyclic_error needs [actuator] screw_lead in rig.toml")
        angle = 2 * np.pi * self.order * motion.lengths / motion.actuator.screw_lead
        return self.struts() * self.amplitude * np.sin(angle + self.phase)
