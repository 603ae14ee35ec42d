"""Screw coupling: twist of the joints becomes strut length.

The platform's cardan turns the nut.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    Covariate,
    Linear,
    Parameter,
    numerical_derivative_step,
)
from rig.errors import RigError
from rig.model.mechanisms.hexapod import cardan_twist_angles_about_struts
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod_or_redundant_hexapod


@dataclass(frozen=True, slots=True)
class ScrewCoupling(Effect):
    """Deviation (gain + growth * twist) * lead / 2 pi * twist of the platform-side cardan against the base-side one,
    less the twist at home.

    growth : of the gain with the twist: a guide that yields turns with the nut more to one side than to the other
    """

    place: str
    gain: float = 0.0
    growth: float = 0.0
    name: ClassVar = "screw_coupling"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "axis")
    parameters: ClassVar = (
        Parameter("gain", "", (-3, 3), (0.1, 1)),
        Parameter("growth", "1/rad", (-10, 10), (0.1, 3), role="form"),
    )
    experiment: ClassVar = "turn the platform about its axis and tilt it, far out: the pose alone determines it"
    action: ClassVar = "Correct lengths by the twist of the joints, or guide the nut so that it cannot turn."
    on_pose: ClassVar = True
    cardans: ClassVar = ("cardan-cardan",)
    whole_turns: ClassVar = True

    def deviation(self, motion: Motion) -> Floats:
        twist = self._twist(motion)
        return self.axes(motion.places) * motion.turn() / (2 * np.pi) * (self.gain + self.growth * twist) * twist

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        plain = cls.linear(place)
        growing = [*plain, Linear("growth", None, numerical_derivative_step(cls.parameters[1]))]
        return [Candidate(cls, place, [{}], plain), Candidate(cls, place, [{}], growing, "growing")]

    def covariate(self, motion: Motion) -> Covariate:
        return Covariate(np.degrees(self._twist(motion)), "twist of the cardans, degrees")

    def _twist(self, motion: Motion) -> Floats:
        reason = self.needs(motion)
        if reason:
            raise RigError(f"{self.name} {reason}")
        m = require_hexapod_or_redundant_hexapod(motion.mechanism)
        return cardan_twist_angles_about_struts(motion.poses(), m) - cardan_twist_angles_about_struts(m.home, m)
