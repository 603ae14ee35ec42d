"""Missed steps of an axis' motor.

From one moment on, the axis is off by whole motor steps.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Covariate, Parameter, time_covariate
from rig.model.arm_hands_effect_places_and_tolerances import Place


@dataclass(frozen=True, slots=True)
class MissedSteps(Effect):
    """Deviation jump (m or rad) from time (s from the recording's start) on."""

    place: str
    jump: float = 0.0
    time: float = 0.0
    name: ClassVar = "missed_steps"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "axis")
    lasting: ClassVar = False
    parameters: ClassVar = (
        Parameter("jump", "m", (-5e-3, 5e-3), (5e-6, 1.2e-4), signed=True, joint=((-0.2, 0.2), (2e-5, 2e-3))),
        Parameter("time", "s", (-np.inf, np.inf), (0, 1e5), role="moment"),
    )
    sudden: ClassVar = True
    form: ClassVar = "step"
    experiment: ClassVar = "return to one pose repeatedly, and home the axis: homing removes a lost step"
    action: ClassVar = (
        "Home the {axis}; then look for an overload, a loose coupling or a current set too low at that moment."
    )

    def deviation(self, motion: Motion) -> Floats:
        return self.axes(motion.places) * self.jump * (motion.t >= self.time)[:, None]

    def covariate(self, motion: Motion) -> Covariate:
        return time_covariate(motion)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        found = super(MissedSteps, cls).candidates(place, context)
        if Place.parse(place).is_axis:
            return found
        axes = len(context.moved().places)  # that all miss the same steps at once is a coincidence for each of them
        return [replace(candidate, extra=candidate.extra + axes - 1) for candidate in found]
