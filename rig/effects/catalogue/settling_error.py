"""Settling error: an axis is photographed before it has arrived.

A fixed part of its last step is missing.
"""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate, Parameter, travel_covariate


@dataclass(frozen=True, slots=True)
class SettlingError(Effect):
    """Deviation -fraction * step, the signed travel of the last straight move before the exposure, whatever its pace
    and the wait after it.
    """

    place: str
    fraction: float = 0.0
    name: ClassVar = "settling_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (Parameter("fraction", "", (-0.1, 0.2), (1e-4, 2e-3)),)
    experiment: ClassVar = (
        "small and large steps to the same poses, from both sides: lost motion does not grow with the step"
    )
    action: ClassVar = (
        "Wait longer before reading, or tighten the {axis}'s window for being in position; until then approach "
        "by small last steps."
    )

    def deviation(self, motion: Motion) -> Floats:
        return -self.axes(motion.places) * self.fraction * motion.once(("last step",), lambda: motion.path.last_step)

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.last_step, motion, "last step")
