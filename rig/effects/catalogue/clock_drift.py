"""Clock drift: the cameras' clock runs fast or slow against the commands'."""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate, Parameter, travel_covariate


@dataclass(frozen=True, slots=True)
class ClockDrift(Effect):
    """Exposures logged at t happened at t (1 + rate) on the commands' clock, both clocks set at the recording's start,
    t = 0.
    """

    place: str
    rate: float = 0.0
    name: ClassVar = "clock_drift"
    stage: ClassVar = "command"
    places: ClassVar = ("clock",)
    lasting: ClassVar = False
    parameters: ClassVar = (Parameter("rate", "", (-1e-2, 1e-2), (1e-6, 1e-4), signed=True),)
    moving: ClassVar = True
    experiment: ClassVar = "expose while moving early and late in a long recording"
    action: ClassVar = "Trigger cameras and controller from one clock."

    def times(self, t: Floats) -> Floats:
        return t * (1 + self.rate)

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.speed * motion.t[:, None], motion, "speed times time")
