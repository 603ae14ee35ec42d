"""Time offset between the cameras' and the commands' clock.

From the start or from a moment on.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate, Parameter, travel_covariate


@dataclass(frozen=True, slots=True)
class TimeOffset(Effect):
    """Exposures logged at t >= since (s from the recording's start) happened at t + offset on the commands' clock."""

    place: str
    offset: float = 0.0
    since: float = -np.inf
    name: ClassVar = "time_offset"
    stage: ClassVar = "command"
    places: ClassVar = ("clock",)
    lasting: ClassVar = False
    parameters: ClassVar = (
        Parameter("offset", "s", (-5, 5), (1e-3, 6e-2), signed=True),
        Parameter("since", "s", (-np.inf, np.inf), (0, 1e5), role="moment"),
    )
    moving: ClassVar = True
    experiment: ClassVar = (
        "expose while moving, at several speeds; reversals at full speed (plan zigzag) or an external clock "
        "distinguish it from a lag of all drives"
    )
    action: ClassVar = "Trigger cameras and controller from one clock, or shift the exposures' times."

    def times(self, t: Floats) -> Floats:
        return t + self.offset * (np.asarray(t) >= self.since)

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.speed, motion, "speed of the axis", "/s")
