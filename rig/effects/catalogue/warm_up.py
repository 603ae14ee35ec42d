"""Warm-up: axes move while the machine warms up without a logged temperature."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import Covariate, Parameter, time_covariate
from rig.effects.framework.machine_motion_and_play import Motion


@dataclass(frozen=True, slots=True)
class WarmUp(Effect):
    """Deviation amplitude * (1 - exp(-t / time_constant)), t from the first command on."""

    place: str
    amplitude: float = 0.0
    time_constant: float = 1800.0
    name: ClassVar = "warm_up"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis", "rig")
    parameters: ClassVar = (
        Parameter("amplitude", "m", (-2e-3, 2e-3), (5e-6, 1.2e-4), joint=((-0.2, 0.2), (1e-5, 1e-3))),
        Parameter("time_constant", "s", (60, 1e5), (600, 7200), role="log"),
    )
    sudden: ClassVar = True
    experiment: ClassVar = (
        "the same poses from a cold start to hours later, with fixed cubes in view: a camera's drift moves those too"
    )
    action: ClassVar = (
        "Let the machine warm up before use, and log the {axis}s' temperatures so that it can be corrected."
    )

    def deviation(self, motion: Motion) -> Floats:
        elapsed = motion.t - motion.path.began
        return self.axes(motion.places) * self.amplitude * (1 - np.exp(-elapsed / self.time_constant))[:, None]

    def covariate(self, motion: Motion) -> Covariate:
        return time_covariate(motion)
