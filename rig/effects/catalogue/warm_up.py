"""Warm-up: axes move while the machine warms up.

There is no logged temperature of it.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import (
    WeightedSum,
    parameter_of_weighted_sum_member_weights,
)
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate, Parameter, time_covariate

SPREAD = 3.0  # times as long as the first, the second time constant


@dataclass(frozen=True, slots=True)
class WarmUp(WeightedSum):
    """Deviation amplitude * (1 - exp(-t / time_constant)), t from the first command on; or shares of the amplitude with
    time_constant and 3 times that, one of them negative where one body is heated through another.
    """

    place: str
    amplitude: float = 0.0
    time_constant: float = 1800.0
    shares: tuple[float, ...] = ()
    name: ClassVar = "warm_up"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis", "rig")
    parameters: ClassVar = (
        Parameter("amplitude", "m", (-2e-3, 2e-3), (5e-6, 1.2e-4), joint=((-0.2, 0.2), (1e-5, 1e-3))),
        Parameter("time_constant", "s", (60, 1e5), (600, 7200), role="log"),
        parameter_of_weighted_sum_member_weights(-5, 6),
    )
    whole: ClassVar = "amplitude"
    scale: ClassVar = "time_constant"
    counts: ClassVar = (2,)
    sudden: ClassVar = True
    experiment: ClassVar = (
        "the same poses from a cold start to hours later, with fixed cubes in view: a camera's drift moves those too"
    )
    action: ClassVar = (
        "Let the machine warm up before use, and log the {axis}s' temperatures so that it can be corrected."
    )

    def member(self, motion: Motion, scale: float, number: int, count: int) -> Floats:
        elapsed = motion.t - motion.path.began
        grown = 1 - np.exp(-elapsed / (scale * SPREAD**number))
        return np.broadcast_to(grown[:, None], motion.lengths.shape)

    def covariate(self, motion: Motion) -> Covariate:
        return time_covariate(motion)
