"""The cameras' clock runs fast or slow against the commands'."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class ClockDrift(Effect):
    """Exposures logged at t happened at t (1 + rate) on the commands' clock, both clocks set at the recording's start, t = 0."""

    place: str
    rate: float = 0.0
    name: ClassVar = "clock_drift"
    stage: ClassVar = "command"
    places: ClassVar = ("clock",)
    parameters: ClassVar = (Parameter("rate", "", (-1e-2, 1e-2), (1e-6, 1e-4), signed=True),)
    experiment: ClassVar = "expose while moving early and late in a long recording"

    def times(self, t):
        return t * (1 + self.rate)
