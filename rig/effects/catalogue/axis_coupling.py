"""Axis coupling: an axis takes part in another's travel.

By wrist gears, a cable, a shared belt.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rig.array_and_json_types import Integers
from rig.effects.framework.effect_base_class import Candidate
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import CURVATURE, ScaleWithCurvature
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    ControllerTerm,
    Covariate,
    Drawing,
    Parameter,
    draw_scalar_parameter,
    travel_covariate,
)


@dataclass(frozen=True, slots=True)
class AxisCoupling(ScaleWithCurvature):
    """Deviation scale * q * (1 + curvature * q / half) of axis number `other` (from 1), q its commanded value less that
    at home, half half of its travel.
    """

    place: str
    scale: float = 0.0
    other: float = 1.0
    curvature: float = 0.0
    name: ClassVar = "axis_coupling"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("scale", "", (-0.1, 0.1), (1e-5, 1e-2), signed=True),
        Parameter("other", "", (1, 100), (1, 6), role="choice"),
        CURVATURE,
    )
    experiment: ClassVar = "move the other axis alone, over its whole travel"
    action: ClassVar = (
        "Enter the coupling in the controller, which can take it out by moving the {axis} along; or part the two "
        "drives."
    )

    def needs(self, motion: Motion) -> str | None:
        if not 1 <= self.other <= len(motion.places):
            return f"takes another axis, 1 to {len(motion.places)}, not {self.other:g}"
        return (
            "requires an axis other than its own"
            if self.scale and self.place == motion.places[int(self.other) - 1]
            else None
        )

    def source(self, motion: Motion) -> Integers:
        return np.full(len(motion.places), int(self.other) - 1)

    def in_controller(self, motion: Motion) -> ControllerTerm:
        return ControllerTerm(self.controller_lines(motion))

    def covariate(self, motion: Motion) -> Covariate:
        other = int(self.other) - 1
        return travel_covariate(
            np.repeat(motion.stroke[:, [other]], len(motion.places), axis=1),
            motion,
            f"stroke of {motion.places[other]} from home",
        )

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        others = [float(i + 1) for i, other in enumerate(drawing.motion.places) if other != place]
        return cls(place, draw_scalar_parameter(cls.parameters[0], drawing, rng), float(rng.choice(others)))

    @classmethod
    def straight_candidates(cls, place: str, context: Context) -> list[Candidate]:
        places = context.moved().places
        nodes = [{"other": float(i + 1)} for i, other in enumerate(places) if other != place]
        return [Candidate(cls, place, nodes, cls.linear(place), extra=1)] if nodes else []
