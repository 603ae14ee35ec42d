"""The cameras' clock is off against the commands': by so much, and if it jumped, from then on."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class TimeOffset(Effect):
    """Exposures logged at t >= since (s from the recording's start) happened at t + offset on the commands' clock."""

    place: str
    offset: float = 0.0
    since: float = -1e9
    name: ClassVar = "time_offset"
    stage: ClassVar = "command"
    places: ClassVar = ("clock",)
    parameters: ClassVar = (Parameter("offset", "s", (-5, 5), (1e-3, 6e-2), signed=True),
                            Parameter("since", "s", (-1e9, 1e9), (0, 1e5), role="moment"))
    experiment: ClassVar = ("expose while moving, at several speeds; reversals at full speed (plan zigzag) or an external clock "
                            "tell it from a lag of all drives")

    def times(self, t):
        return t + self.offset * (np.asarray(t) >= self.since)
