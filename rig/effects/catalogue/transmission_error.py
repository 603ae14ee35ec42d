"""Transmission error of a screw, gear or encoder.

A profile that repeats with an axis' own position.
"""

from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Self

import numpy as np
import scipy

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    COUNT,
    Context,
    Covariate,
    Drawing,
    Linear,
    Node,
    Parameter,
    draw_log_uniform,
    numerical_derivative_step,
    travel_covariate,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place

KNOTS = (5, 9, 14, 24)  # of a strut's profile, or a slide's
SPACINGS = (1.0, 0.5, 0.25, 0.12, 0.07, 0.05, 0.035)  # rad between knots of a joint's profile
FEWEST = 4  # knots
SHARE = 0.125  # of the exposures: more knots than that are no profile


@dataclass(frozen=True, slots=True)
class TransmissionError(Effect):
    """Deviation: a natural cubic spline through profile (m or rad), evenly spaced over span (m or rad), by default the
    axis' whole travel; beyond its ends it stays what it was there. rms is its size."""

    place: str
    profile: tuple[float, ...] = (0.0, 0.0)
    span: tuple[float, ...] = ()
    name: ClassVar = "transmission_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("profile", "m", (-1e-3, 1e-3), (5e-6, 5e-5), 0, joint=((-0.1, 0.1), (5e-5, 5e-4))),
        Parameter("span", "m", (-1e3, 1e3), (0, 10), 0, role="choice", joint=((-1e3, 1e3), (-3, 3))),
    )
    experiment: ClassVar = "the whole stroke of that axis in small steps, from both sides"
    action: ClassVar = (
        "Put the profile into the controller's table of the {axis}'s errors, or exchange its screw, gear or encoder."
    )
    form: ClassVar = "profile"
    own_axis: ClassVar = 3
    once: ClassVar = True

    def problem(self) -> str | None:
        if len(self.span) not in (0, 2) or (len(self.span) == 2 and not self.span[0] < self.span[1]):
            return f"span has two numbers, the smaller first, not {list(self.span)}"
        return None if len(self.profile) > 1 else "profile has at least 2 numbers, at the ends of its span"

    @property
    def rms(self) -> float:
        """m or rad, root mean square of the profile."""
        return float(np.sqrt(np.mean(np.square(self.profile))))

    def deviation(self, motion: Motion) -> Floats:
        out = np.zeros(motion.lengths.shape)
        for i in np.flatnonzero(self.axes(motion.places)):
            span = self.span or motion.kind.travel_ranges(motion.mechanism)[i]
            out[:, i] = cubic_spline_values(motion.lengths[:, i], span, np.asarray(self.profile, float))
        return out

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.stroke, motion, "stroke from home")

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        p, at = cls.parameters[0].at(place), Place.parse(place)
        if at.kind == "strut" and not at.stage:
            return [cls._of(place, {COUNT: count}, p) for count in KNOTS]
        q = context.moved().lengths[:, context.moved().places.index(place)]
        span = (float(q.min()), float(max(q.max(), q.min() + 1e-6)))
        counts = (
            sorted({max(FEWEST, int(np.ceil((span[1] - span[0]) / spacing)) + 1) for spacing in SPACINGS})
            if at.kind == "joint"
            else list(KNOTS)
        )
        return [cls._of(place, {COUNT: count, "span": span}, p) for count in counts if count <= SHARE * len(q)]

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        profile = np.cumsum(rng.normal(size=rng.integers(6, 12)))
        profile -= profile.mean()
        return cls(
            place,
            tuple(
                (
                    profile * draw_log_uniform(rng, *cls.parameters[0].at(place).usual) / np.sqrt(np.mean(profile**2))
                ).tolist()
            ),
        )

    @classmethod
    def _of(cls, place: str, node: Node, p: Parameter) -> Candidate:
        return Candidate(
            cls,
            place,
            [node],
            [Linear(p.name, j, numerical_derivative_step(p)) for j in range(node[COUNT])],
            f"{node[COUNT]} knots",
        )

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        i = motion.places.index(candidate.place)
        out = np.zeros((*motion.lengths.shape, node[COUNT]))
        out[:, i] = cubic_spline_values(
            motion.lengths[:, i],
            node.get("span") or motion.kind.travel_ranges(motion.mechanism)[i],
            np.eye(node[COUNT]),
        )
        return out


def cubic_spline_values(q: Floats, span: tuple[float, ...] | Floats, values: Floats) -> Floats:
    """Values (n, ...) at q (n,) of cubic splines through values at even knots.

    The splines are natural, through values (knots, ...) at even knots over a span.
    """
    low, high = span
    last = len(values) - 1
    u = (np.clip(q, low, high) - low) * (last / (high - low))
    i = np.minimum(u.astype(int), last - 1)
    after = (u - i).reshape(-1, *(1,) * (values.ndim - 1))
    before, bends = 1 - after, natural_spline_curvature_matrix(len(values)) @ values
    straight = before * values[i] + after * values[i + 1]
    curved: Floats = straight + ((before**3 - before) * bends[i] + (after**3 - after) * bends[i + 1]) / 6
    return curved


@cache
def natural_spline_curvature_matrix(knots: int) -> Floats:
    """Matrix (knots, knots) that gives a natural cubic spline's second derivatives at its knots.

    It multiplies the values there; knots are one apart.
    """
    at = np.arange(knots)
    curvatures: Floats = scipy.interpolate.CubicSpline(at, np.eye(knots), bc_type="natural")(at, 2)
    return curvatures
