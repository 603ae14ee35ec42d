"""The platform shakes: a sinusoid in time, caught at the moment of exposure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class Vibration(Effect):
    """Displacement amplitude * sin(2 pi frequency t + phase) along mode 0..5: x y z (m), or a turn about x y z that moves the
    platform's joints by the amplitude."""

    place: str
    amplitude: float = 0.0
    frequency: float = 10.0
    mode: float = 2.0
    phase: float = 0.0
    name: ClassVar = "vibration"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    parameters: ClassVar = (Parameter("amplitude", "m", (0, 5e-3), (1e-6, 1e-4)),
                            Parameter("frequency", "Hz", (1e-4, 1e3), (0.1, 50), role="frequency"),
                            Parameter("mode", "", (0, 5), (0, 5), role="choice"), Parameter("phase", "rad", (-7, 7), (-3.1416, 3.1416), role="phase"))
    experiment: ClassVar = "many exposures of one pose at irregular times"

    def sway(self, motion):
        out = np.zeros((len(motion.t), 6))
        mode = int(self.mode)
        reach = 1.0 if mode < 3 else np.linalg.norm(motion.mechanism.platform_joints, axis=1).mean()
        out[:, mode] = self.amplitude / reach * np.sin(2 * np.pi * self.frequency * motion.t + self.phase)
        return out
