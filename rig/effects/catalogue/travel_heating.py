"""Travel heating: an axis is warmed by its own travel.

It cools at rest, so it grows by how much it has moved.
"""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate, Parameter, travel_covariate


@dataclass(frozen=True, slots=True)
class TravelHeating(Effect):
    """Deviation per_metre * h, h the travel that still warms the axis: dh/dt = |dl/dt| - h / time_constant, 0 at the
    first command, l the command, by Newton's law of cooling. A warm strut is longer; a joint may turn either way."""

    place: str
    per_metre: float = 0.0
    time_constant: float = 600.0
    name: ClassVar = "travel_heating"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("per_metre", "", (0, 1e-2), (1e-5, 2e-4), joint=((-1e-2, 1e-2), (1e-5, 2e-4))),
        Parameter("time_constant", "s", (10, 1e5), (100, 2000), role="log"),
    )
    experiment: ClassVar = "rest until all is cold, then work one {axis} to and fro for an hour, the others still"
    action: ClassVar = (
        "Rest between moves or run the {axis} warm before use; log its temperature so that it can be corrected."
    )

    def deviation(self, motion: Motion) -> Floats:
        return self.axes(motion.places) * self.per_metre * motion.recent_travel(self.time_constant)

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.recent_travel(self.time_constant), motion, "recent travel, whichever way")
