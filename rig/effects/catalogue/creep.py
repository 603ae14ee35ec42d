"""Creep: a part of every move arrives late, approaching the command with a time constant."""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.catalogue.servo_lag import lagged_path
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import Parameter
from rig.effects.framework.machine_motion_and_play import Motion


@dataclass(frozen=True, slots=True)
class Creep(Effect):
    """Deviation -fraction * (command - its first-order lag of time_constant)."""

    place: str
    fraction: float = 0.0
    time_constant: float = 30.0
    name: ClassVar = "creep"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis", "rig")
    parameters: ClassVar = (
        Parameter("fraction", "", (0, 0.2), (1e-3, 1e-2)),
        Parameter("time_constant", "s", (0.05, 1e4), (1, 1000), role="log"),
    )
    experiment: ClassVar = "expose repeatedly during one long dwell after a large move"
    action: ClassVar = (
        "Dwell longer before measuring, by a few time constants; look for a soft joint or a drive that settles late."
    )

    def deviation(self, motion: Motion) -> Floats:
        path = motion.path
        late = motion.once(
            ("late", self.time_constant), lambda: (path.lengths - lagged_path(path, self.time_constant))[path.at]
        )
        return -self.axes(motion.places) * self.fraction * late
