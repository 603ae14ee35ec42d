"""A motor lost steps: from one moment on, a strut is off by whole steps."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class MissedSteps(Effect):
    """Deviation jump (m) from time (s from the recording's start) on."""

    place: str
    jump: float = 0.0
    time: float = 0.0
    name: ClassVar = "missed_steps"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("jump", "m", (-5e-3, 5e-3), (5e-6, 1.2e-4), signed=True),
                            Parameter("time", "s", (-1e9, 1e9), (0, 1e5), role="moment"))
    sudden: ClassVar = True
    experiment: ClassVar = "return to one pose again and again, and home the strut: homing takes a lost step away"

    def deviation(self, motion):
        return self.struts() * self.jump * (motion.t >= self.time)[:, None]
