"""Compliance: axes yield elastically under load.

In static equilibrium.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import independent_load_column_indices
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
    draw_parameter,
    load_covariate,
)
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links

HEAVIEST, LIGHTER, OFF_CENTRE = (
    (4.0, 15.0),
    0.7,
    0.1,
)  # kg of a first link, each next one's share of it, m: of links that are drawn
STIFFENS = (0.3, 0.6, 1.2, 2.5)  # greatest loads over that at which an axis yields half as far, which a search tries
PARALLEL = float(np.cos(np.radians(5)))  # cosine between axes from which they are parallel
LINK = 4  # numbers of a link: its mass and three mass moments
GIVES = 1e-3  # rad RMS; real joints give a tenth of it under an arm's own weight


@dataclass(frozen=True, slots=True)
class Compliance(Effect):
    """Deviation -f / stiffness / (1 + |f| stiffening): a strut that pushes is compressed and shorter, a joint gives way
    to what it holds. Infinite stiffness gives nothing; a stiffening of 0 is a plain spring.

    moments : where the weight of an arm's links is not stated, their masses and mass moments (kg and kg m, four for
    each link, along its frame) over the stiffness, in place of f / stiffness: 1/(m/s^2), as far as they are not stated
    with the platform. Links beyond the last stated one weigh nothing.
    """

    place: str
    stiffness: float = np.inf
    moments: tuple[float, ...] = ()
    stiffening: float = 0.0
    name: ClassVar = "compliance"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "axis")
    parameters: ClassVar = (
        Parameter("stiffness", "N/m", (1e4, np.inf), (1e6, 1e8), role="inverse", joint=((1.0, np.inf), (1e3, 1e7))),
        Parameter("moments", "kg/(N m/rad), kg m/(N m/rad)", (-1.0, 1.0), (1e-7, 1e-3), 0),
        Parameter("stiffening", "1/N", (0, 100), (1e-4, 1e-1), role="choice", joint=((0, 100), (1e-4, 1e-1))),
    )
    experiment: ClassVar = "change the payload: at constant load most of the sag hides in the joint geometry"
    action: ClassVar = (
        "Correct the {axis} by its load, or look for a soft mount; calibrate with the load that the machine will carry."
    )
    on_pose: ClassVar = True
    form: ClassVar = "load"
    once: ClassVar = True

    def needs(self, motion: Motion) -> str | None:
        if not self.moments:
            return motion.no_loads()
        count = motion.links().shape[2]
        return (
            None
            if len(self.moments) <= count and len(self.moments) % LINK == 0
            else f"takes up to {count} moments, four for each link that the axes carry, not {len(self.moments)}"
        )

    def deviation(self, motion: Motion) -> Floats:
        mask = self.axes(motion.places)
        out = (
            np.zeros(motion.lengths.shape)
            if self.moments and np.isinf(self.stiffness)
            else -mask * motion.loads() / self.stiffness / (1 + np.abs(motion.loads()) * self.stiffening)
        )
        if self.moments:
            reason = self.needs(motion)
            if reason:
                raise RigError(f"{self.name} {reason}")
            out = out - mask * (motion.links()[..., : len(self.moments)] @ np.asarray(self.moments))
        return out

    def covariate(self, motion: Motion) -> Covariate:
        if self.moments:
            return super(Compliance, self).covariate(motion)
        return load_covariate(motion.loads(), motion, "{unit} (positive: the {axis} pushes)")

    def fitted(self, parameter: Parameter) -> tuple[int | None, ...]:
        if self.moments:
            return tuple(i for i, v in enumerate(self.moments) if v) if parameter.name == "moments" else ()
        return (None,) if parameter.name == "stiffness" else ()

    @classmethod
    def unusual(cls, place: str, values: Mapping[str, object]) -> str | None:
        turn = values.get("rms", 0.0)
        if isinstance(turn, int | float) and turn > GIVES:
            words = (
                f"turn by {turn * 1e3:.2g} mrad"
                if Place.parse(place).kind == "joint"
                else f"move by {turn * 1e3:.2g} mm"
            )
            return (
                f"{place} would {words} RMS under its load, ten times what gears and bearings give: something else may "
                "hide behind it"
            )
        return super(Compliance, cls).unusual(place, values)

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        return places_loaded_by_links_only(context) or super(Compliance, cls).sites(context)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        motion = context.moved()
        if not motion.no_loads():
            column = cls.linear(place)[:1]
            most = float(np.abs(motion.loads()).max(initial=0.0))
            nodes = [{"stiffening": share / most} for share in STIFFENS] if most > 0 else []
            stiffening = [Candidate(cls, place, nodes, column, "stiffening", extra=1)] if nodes else []
            return [Candidate(cls, place, [{}], column), *stiffening]
        joint, found = motion.places.index(place), list[Candidate]()
        table, fewest = motion.links()[:, joint], LINK * _links_about_parallel_axes(joint, motion)
        for count in range(fewest, table.shape[1] + 1, LINK):  # a wrist's own weight often turns nothing to speak of
            retained = independent_load_column_indices(table[:, :count])
            if len(retained) > (len(found[-1].linear) if found else 0):
                linear = [Linear("moments", int(i), 1e-5) for i in retained]
                found.append(Candidate(cls, place, [{COUNT: count}], linear, f"moments of {count // LINK} links"))
        return found

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        if not drawing.motion.no_loads() or drawing.motion.T is None:
            return super(Compliance, cls).drawn(place, drawing, rng)
        links = drawing.motion.links().shape[2] // 4
        mass = LIGHTER ** np.arange(links) * draw_log_uniform(rng, *HEAVIEST)
        moments = mass[:, None] * np.column_stack([np.ones(links), rng.uniform(-OFF_CENTRE, OFF_CENTRE, (links, 3))])
        stiffness = draw_parameter(cls.parameters_at(place)[0], drawing, rng)
        return cls(place, moments=tuple((moments / stiffness).ravel().tolist()))

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        if COUNT not in node:
            return super(Compliance, cls).columns(candidate, node, motion)
        i = motion.places.index(candidate.place)
        out = np.zeros((*motion.lengths.shape, len(candidate.linear)))
        out[:, i] = -motion.links()[:, i][:, [column.entry for column in candidate.linear if column.entry is not None]]
        return out


def _links_about_parallel_axes(joint: int, motion: Motion) -> int:
    """How many links, from the first on, an arm has up to the last that turns about an axis parallel to a joint's.

    Their weights load that joint alike; one that is left out is taken for others'.
    """
    if not has_links(motion.mechanism):
        return 1
    parallel = np.abs(np.cos(motion.mechanism.rows[joint:-1, 3])) > PARALLEL
    return joint + 1 + int(np.cumprod(parallel).sum())


def places_loaded_by_links_only(context: Context) -> tuple[str, ...]:
    """Places of axes that only the links load.

    Their load is known through the links' masses.
    """
    motion = context.moved()
    return motion.places if motion is not None and motion.no_loads() and motion.links().shape[2] else ()
