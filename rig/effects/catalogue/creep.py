"""Creep: an axis moves on slowly after each move.

Its last part arrives exponentially, with a time constant.
"""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import (
    WeightedSum,
    lagged_lengths,
    parameter_of_weighted_sum_member_weights,
)
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter

SPREAD = 5.0  # times as long as the one before, each further time constant


@dataclass(frozen=True, slots=True)
class Creep(WeightedSum):
    """Deviation -fraction * (command - its first-order lag of time_constant); or shares of the fraction lag with
    time_constant, 5 and 25 times that: slow processes have no single time, and the logarithm of time is many.
    """

    place: str
    fraction: float = 0.0
    time_constant: float = 30.0
    shares: tuple[float, ...] = ()
    name: ClassVar = "creep"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis", "rig")
    parameters: ClassVar = (
        Parameter("fraction", "", (0, 0.2), (1e-3, 1e-2)),
        Parameter("time_constant", "s", (0.05, 1e4), (1, 1000), role="log"),
        parameter_of_weighted_sum_member_weights(0, 1),
    )
    whole: ClassVar = "fraction"
    scale: ClassVar = "time_constant"
    counts: ClassVar = (2, 3)
    experiment: ClassVar = "expose repeatedly during one long dwell after a large move"
    action: ClassVar = (
        "Dwell longer before measuring, by a few time constants; look for a soft joint or a drive that settles late."
    )

    def member(self, motion: Motion, scale: float, number: int, count: int) -> Floats:
        path = motion.path
        return (lagged_lengths(path, scale * SPREAD**number) - path.lengths)[path.at]
