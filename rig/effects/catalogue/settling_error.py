"""Settling error: an axis is photographed before it has arrived.

A fixed part of its last step is missing.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    COUNT,
    Context,
    Covariate,
    Linear,
    Node,
    Parameter,
    numerical_derivative_step,
    travel_covariate,
)

GROWTH = (-0.4, 2.0)  # of the fraction, per half of the axis' travel: beyond, a step of the whole travel turns its sign


@dataclass(frozen=True, slots=True)
class SettlingError(Effect):
    """Deviation -fraction * step * (1 + growth * |step| / half), step the signed travel of the last straight move
    before the exposure, whatever its pace and the wait after it, half half of the axis' travel.
    """

    place: str
    fraction: float = 0.0
    growth: float = 0.0
    name: ClassVar = "settling_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("fraction", "", (-0.1, 0.2), (1e-4, 2e-3)),
        Parameter("growth", "", GROWTH, (0.05, 1.0), role="form"),
    )
    experiment: ClassVar = (
        "small and large steps to the same poses, from both sides: lost motion does not grow with the step"
    )
    action: ClassVar = (
        "Wait longer before reading, or tighten the {axis}'s window for being in position; until then approach "
        "by small last steps."
    )

    def deviation(self, motion: Motion) -> Floats:
        step = motion.once(("last step",), lambda: motion.path.last_step)
        grown = 1 + self.growth * share_of_half_travel(motion) if self.growth else 1.0
        return -self.axes(motion.places) * self.fraction * step * grown

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.last_step, motion, "last step")

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        plain = super(SettlingError, cls).candidates(place, context)
        step = numerical_derivative_step(cls.parameters_at(place)[0])
        grown = [Linear("fraction", 0, step), Linear("fraction", 1, 0.1 * step)]
        return plain + [
            replace(c, grid=[{**node, COUNT: 2} for node in c.grid], linear=grown, label="growing") for c in plain
        ]

    @classmethod
    def composed(cls, candidate: Candidate, node: Node, coefficients: Floats) -> Effect:
        if COUNT not in node:
            return super(SettlingError, cls).composed(candidate, node, coefficients)
        fraction, grown = np.asarray(coefficients, float).tolist()
        return cls(candidate.place, fraction, float(np.clip(grown / fraction, *GROWTH)) if fraction else 0.0)

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        if COUNT not in node:
            return super(SettlingError, cls).columns(candidate, node, motion)
        plain = cls(candidate.place, fraction=1.0).deviation(motion)
        return np.stack([plain, plain * share_of_half_travel(motion)], axis=-1)


def share_of_half_travel(motion: Motion) -> Floats:
    """(n, axes) length of each axis' last step, as a share of half its travel."""
    ranges = motion.kind.travel_ranges(motion.mechanism)
    step = motion.once(("last step",), lambda: motion.path.last_step)
    return np.asarray(np.abs(step) * 2 / (ranges[:, 1] - ranges[:, 0]))
