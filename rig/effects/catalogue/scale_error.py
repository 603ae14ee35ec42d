"""Scale error of an axis: a share of the stroke from home."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import (
    ControllerTerm,
    Covariate,
    Parameter,
    travel_covariate,
)
from rig.effects.framework.machine_motion_and_play import Motion


@dataclass(frozen=True, slots=True)
class ScaleError(Effect):
    """Deviation scale * q, q the commanded value less that at home."""

    place: str
    scale: float = 0.0
    name: ClassVar = "scale_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "axis")
    parameters: ClassVar = (
        Parameter("scale", "", (-5e-3, 5e-3), (5e-5, 1e-3), signed=True, joint=((-5e-2, 5e-2), (5e-5, 2e-3))),
    )
    experiment: ClassVar = (
        "a certified length along the {axis}, or a target of certified size: all scales equal look like a print scale"
    )
    joint_experiment: ClassVar = (
        "an angle of that joint certified by another instrument, or poses over more of its travel"
    )
    action: ClassVar = (
        "Enter the {axis}'s scale in the controller (steps per unit of travel), or have its drive's transmission "
        "certified."
    )
    form: ClassVar = "slope"
    own_axis: ClassVar = 1
    once: ClassVar = True

    def deviation(self, motion: Motion) -> Floats:
        return self.axes(motion.places) * self.scale * motion.stroke

    def in_controller(self, motion: Motion) -> ControllerTerm:
        return ControllerTerm(
            tuple(
                f"d[{i}] += {self.scale!r} * (c[{i}] - {motion.home[i].item()!r});"
                for i in np.flatnonzero(self.axes(motion.places)).tolist()
            )
        )

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.stroke, motion, "stroke from home")
