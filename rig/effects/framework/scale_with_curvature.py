"""Scale with a curvature, a base of effects.

They are proportional to a travel from home, and their proportion may grow along it.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect import Candidate, Effect
from rig.effects.framework.effect_parameters_and_covariates import (
    COUNT,
    Context,
    Linear,
    Node,
    Parameter,
    derivative_step,
)
from rig.effects.framework.machine_motion_and_play import Motion

MOST = 0.5  # of the scale by which it may change over half the travel: more is a profile rather than a scale
CURVATURE = Parameter("curvature", "", (-MOST, MOST), (0.05, 0.3), role="form", signed=True)


class ScaleWithCurvature(Effect):
    """Deviation scale * q * (1 + curvature * q / half), q a travel from home, half half of the axis' whole travel."""

    __slots__ = ()
    if TYPE_CHECKING:  # fields of every such effect
        scale: float
        curvature: float

    def source(self, motion: Motion) -> Integers:
        """(axes,) number of the axis, from 0, whose travel each axis' deviation is proportional to."""
        return np.arange(len(motion.places))

    def half_travel(self, motion: Motion) -> Floats:
        """(axes,) m or rad, half of the travel of each axis' source."""
        ranges = motion.kind.travel_ranges(motion.mechanism)
        return np.asarray((ranges[:, 1] - ranges[:, 0]) / 2)[self.source(motion)]

    def deviation(self, motion: Motion) -> Floats:
        q = motion.stroke[:, self.source(motion)]
        grown = 1 + self.curvature * q / self.half_travel(motion) if self.curvature else 1.0
        return self.axes(motion.places) * self.scale * q * grown

    def controller_lines(self, motion: Motion) -> tuple[str, ...]:
        """What a controller computes of it at its axes, in C."""
        half, lines = self.half_travel(motion), []
        for i in np.flatnonzero(self.axes(motion.places)).tolist():
            source = int(self.source(motion)[i])
            travel = f"(c[{source}] - {motion.home[source].item()!r})"
            growth = f" * (1.0 + {self.curvature / half[i].item()!r} * {travel})" if self.curvature else ""
            lines.append(f"d[{i}] += {self.scale!r} * {travel}{growth};")
        return tuple(lines)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        scale, straight = cls.parameters_at(place)[0], cls.straight_candidates(place, context)
        step = derivative_step(scale)  # of the scale; what the curvature adds is a share of it
        curved = [Linear(scale.name, 0, step), Linear(scale.name, 1, 0.1 * step)]
        return straight + [
            replace(c, grid=[{**node, COUNT: 2} for node in c.grid], linear=curved, label="curved") for c in straight
        ]

    @classmethod
    def straight_candidates(cls, place: str, context: Context) -> list[Candidate]:
        """The candidates without a curvature."""
        return super().candidates(place, context)

    @classmethod
    def composed(cls, candidate: Candidate, node: Node, coefficients: Floats) -> Effect:
        if COUNT not in node:
            return super().composed(candidate, node, coefficients)
        scale, bent = np.asarray(coefficients, float).tolist()
        curvature = float(np.clip(bent / scale, -MOST, MOST)) if scale else 0.0
        return cls(candidate.place, scale=scale, curvature=curvature, **_values(node))

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        if COUNT not in node:
            return super().columns(candidate, node, motion)
        effect = cls(candidate.place, scale=1.0, **_values(node))
        straight = effect.deviation(motion)
        share = motion.stroke[:, effect.source(motion)] / effect.half_travel(motion)
        return np.stack([straight, straight * share], axis=-1)


def _values(node: Node) -> Node:
    """The parameters among a node's entries."""
    return {name: value for name, value in node.items() if name != COUNT}
