"""Hysteresis of friction and springs in a drive: nested loops that do not saturate at one gap."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import Covariate, Parameter, travel_covariate
from rig.effects.framework.machine_motion_and_play import Motion, play_deviation

PLAYS = 8  # operators that stand for the continuum


@dataclass(frozen=True, slots=True)
class Hysteresis(Effect):
    """Prandtl-Ishlinskii: weight times the mean lag of plays whose half widths are spread evenly up to range."""

    place: str
    range: float = 5e-3
    weight: float = 0.0
    name: ClassVar = "hysteresis"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("range", "m", (1e-5, 0.1), (1e-3, 2e-2), role="log", joint=((1e-5, 10), (1e-3, 1.0))),
        Parameter("weight", "", (0, 1), (1e-3, 1e-2)),
    )
    experiment: ClassVar = "reversals of growing amplitude: a backlash saturates at its gap, nested loops keep widening"
    action: ClassVar = (
        "Look for friction with elastic wind-up in the {axis}'s drive train; until then approach every pose from "
        "the same side."
    )

    def forgets(self) -> float:
        return 2 * self.range if self.weight else 0.0

    def deviation(self, motion: Motion) -> Floats:
        halves = self.range * (np.arange(PLAYS) + 0.5) / PLAYS
        lag = motion.once(
            ("loops", self.range), lambda: np.mean([play_deviation(motion, half) for half in halves], axis=0)
        )
        return self.axes(motion.places) * self.weight * lag

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.since_reversal, motion, "travel since the last reversal (negative: inward)")
