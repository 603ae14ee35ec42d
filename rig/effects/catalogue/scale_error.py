"""Scale error of an axis.

A share of the stroke from home.
"""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import CURVATURE, ScaleWithCurvature
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    ControllerTerm,
    Covariate,
    Parameter,
    travel_covariate,
)


@dataclass(frozen=True, slots=True)
class ScaleError(ScaleWithCurvature):
    """Deviation scale * q * (1 + curvature * q / half), q the commanded value less that at home, half half of the
    axis' travel.
    """

    place: str
    scale: float = 0.0
    curvature: float = 0.0
    name: ClassVar = "scale_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "axis")
    parameters: ClassVar = (
        Parameter("scale", "", (-5e-3, 5e-3), (5e-5, 1e-3), signed=True, joint=((-5e-2, 5e-2), (5e-5, 2e-3))),
        CURVATURE,
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

    def in_controller(self, motion: Motion) -> ControllerTerm:
        return ControllerTerm(self.controller_lines(motion))

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.stroke, motion, "stroke from home")
