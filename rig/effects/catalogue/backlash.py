"""Backlash (lost motion) of an axis.

The axis follows its command only once the gap is taken up.
"""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion, play_deviation
from rig.effects.framework.parameters_covariates_and_marker_table import (
    ControllerTerm,
    Covariate,
    Parameter,
    travel_covariate,
)


@dataclass(frozen=True, slots=True)
class Backlash(Effect):
    """Play operator of width gap on the command, over the whole path. Positive: an axis driven outward stays half a gap
    short.
    """

    place: str
    gap: float = 0.0
    name: ClassVar = "backlash"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("gap", "m", (0, 1e-3), (5e-6, 2e-4), role="size", joint=((0, 5e-2), (2e-5, 5e-3))),
    )
    experiment: ClassVar = "a ladder of reversal amplitudes: every position approached from both sides"
    action: ClassVar = (
        "Preload or exchange nut, gear and bearings of the {axis}; until then approach every pose from the same side."
    )

    def forgets(self) -> float:
        return self.gap

    def deviation(self, motion: Motion) -> Floats:
        return self.axes(motion.places) * play_deviation(motion, self.gap / 2)

    def in_controller(self, motion: Motion) -> ControllerTerm:
        return ControllerTerm(gaps=tuple((self.gap * self.axes(motion.places)).tolist()))

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.since_reversal, motion, "travel since the last reversal (negative: inward)")
