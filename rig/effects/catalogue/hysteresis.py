"""Hysteresis of a strut or joint.

From friction and springs in its drive: nested loops that do not saturate at one gap.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import (
    WeightedSum,
    parameter_of_weighted_sum_member_weights,
)
from rig.effects.framework.machine_motion_and_play import Motion, play_deviation
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Covariate,
    Drawing,
    Parameter,
    draw_log_uniform,
    travel_covariate,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place

PLAYS = 8  # operators that stand for the continuum
LOST, LOST_TURN = (2e-6, 5e-5), (1e-5, 1e-3)  # m, rad: what rigs lose between the two directions


@dataclass(frozen=True, slots=True)
class Hysteresis(WeightedSum):
    """Prandtl-Ishlinskii: weight times the lag of plays whose half widths are spread evenly up to range, all alike, or
    each with its own share of the weight: any loops of friction and springs that remember where they turned round.
    """

    place: str
    range: float = 5e-3
    weight: float = 0.0
    shares: tuple[float, ...] = ()
    name: ClassVar = "hysteresis"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("range", "m", (1e-5, 0.1), (1e-3, 2e-2), role="log", joint=((1e-5, 10), (1e-3, 1.0))),
        Parameter("weight", "", (0, 1), (1e-3, 0.1)),
        parameter_of_weighted_sum_member_weights(0, 1),
    )
    whole: ClassVar = "weight"
    scale: ClassVar = "range"
    counts: ClassVar = (4, PLAYS)
    experiment: ClassVar = "reversals of growing amplitude: a backlash saturates at its gap, nested loops keep widening"
    action: ClassVar = (
        "Look for friction with elastic wind-up in the {axis}'s drive train; until then approach every pose from "
        "the same side."
    )

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        reach, weight = cls.parameters_at(place)[:2]
        width = draw_log_uniform(rng, *reach.usual)
        lost = draw_log_uniform(rng, *(LOST_TURN if Place.parse(place).kind == "joint" else LOST))
        return cls(place, width, float(np.clip(2 * lost / width, *weight.usual)))

    def forgets(self) -> float:
        return 2 * self.range if self.weight else 0.0

    def standard_shares(self) -> tuple[float, ...]:
        return (1 / PLAYS,) * PLAYS

    def member(self, motion: Motion, scale: float, number: int, count: int) -> Floats:
        return play_deviation(motion, scale * (number + 0.5) / count)

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.since_reversal, motion, "travel since the last reversal (negative: inward)")
