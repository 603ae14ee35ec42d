"""Part of every move arrives late."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.base import Effect, Parameter
from rig.effects.servo_lag import lag


@dataclass(frozen=True, slots=True)
class Creep(Effect):
    """Deviation -fraction * (length - its first-order lag of time_constant)."""

    place: str
    fraction: float = 0.0
    time_constant: float = 30.0
    name: ClassVar = "creep"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut", "rig")
    parameters: ClassVar = (Parameter("fraction", "", (0, 0.2), (1e-3, 1e-2)), Parameter("time_constant", "s", (0.05, 1e4), (1, 1000), role="log"))
    experiment: ClassVar = "expose repeatedly during one long dwell after a large move"

    def deviation(self, motion):
        path = motion.path
        late = path.lengths - lag(path.t, path.lengths, self.time_constant)
        return -self.struts() * self.fraction * late[path.at]
