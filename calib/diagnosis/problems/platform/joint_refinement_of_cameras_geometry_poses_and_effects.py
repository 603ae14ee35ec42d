"""Joint refinement of a platform's cameras, geometry, poses and effects.

All are refined together, with the effects' parameters, by Gauss-Newton.

A parameter that the data pull beyond its bounds stands at its bound, and the others make the best of it there.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import cast

import numpy as np
from scipy.linalg import block_diag

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Z95, Interval
from calib.diagnosis.engine.linear_residual_model import Column, join_columns
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    SIZED,
    PlatformScore,
    Sensitivities,
    coefficient_bounds,
    effect_coordinates_and_directions,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel, linearise
from calib.diagnosis.problems.platform.linearised_corners import CLIP, repeated_corner_error
from calib.diagnosis.problems.platform.operating_point_steps_and_costs import (
    cost_without_relinearisation,
    likelihood_cost,
    operating_point_and_nuisance_moves_after_step,
)
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import candidate_column
from calib.identify.bounded_and_robust_least_squares_fit import bounded_step_and_covariance
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import (
    Coordinate,
    conserved_coordinate_sums,
    effect_with_valid_place_and_parameters,
    effects_with_coordinates,
    inverse_prior_standard_deviation,
)
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

MAX_ITERATIONS = 20  # few need more than eight; a large effect is not linear in its numbers
SMALL = 0.02  # standard deviations; a step below settles a parameter
SHARES = 1.0, 0.5, 0.2, 0.05  # of a step, tried in turn until one lowers the cost
ENOUGH = 0.3  # of the cost; an iteration that gains less is the last
# of the cost: a trial has cameras and poses at their best by derivatives, so that a step of these alone shows no gain
SLACK = ENOUGH


@dataclass(frozen=True, eq=False, repr=False)
class Refinement(FieldSummaryRepr):
    """point, model : at the optimum; coordinates : of the effects' parameters; values : (c,); covariance : (c, c) of
    them given nothing else; column : Column of their directions"""

    point: OperatingPoint
    model: LinearisedModel
    coordinates: list[Coordinate]
    values: Floats
    covariance: Floats
    column: Column | None
    _last_without: list[tuple[int, Sensitivities, "Refinement"]] = field(default_factory=list, init=False)

    def without_term(self, number: int, sensitivities: Sensitivities) -> "Refinement":
        """Refinement without an admitted effect, standing corners at this one's covariance; the last one asked for is
        made once.
        """
        for known, by, refined in self._last_without:
            if known == number and by is sensitivities:
                return refined
        refined = refine_at_fixed_repeated_corner_error(
            operating_point_without_term(self, number), sensitivities, self.model
        )
        self._last_without[:] = [(number, sensitivities, refined)]
        return refined

    @cached_property
    def marginalised(self) -> LinearisedModel:
        """The model with the effects' parameters among the nuisances."""
        return self.model if self.column is None else self.model.marginalise(self.column)

    def likelihood(self, other: "Refinement") -> float:
        """Minus twice the log likelihood at the optimum, but for a constant; to compare with another, as few px of
        standing corners repeat as in the better of both, and struts scatter as in the likelier: whether one does is
        asked by its own share, which what explains more may bring below what is asked.
        """
        standing = min(self.point.standing, other.point.standing)
        point = replace(self.point, standing=standing)
        # poses as uncertain as in that of both which explains more of their corners' errors
        alike = min((self.model, other.model), key=lambda model: model.corners.total_spread())
        same = standing == self.point.standing and alike.corners.spread is self.model.corners.spread
        own = self.model if same else linearise(point, as_uncertain_as=alike)
        scatter = other.model.closures.scatter
        if not scatter.any() or (scatter == own.closures.scatter).all():
            return likelihood_cost(own)
        return min(likelihood_cost(own), likelihood_cost(linearise(point, CLIP, own, scatter, alike)))

    def wald(self, effect: int) -> tuple[float, int]:
        """(statistic, parameters): how far effect number `effect` stands from nothing, in squared standard deviations,
        its shape held: a shape that its size leaves open says nothing against it."""
        seen = np.diag(self.covariance) > 0  # what moves nothing has no covariance, and says nothing
        own = [i for i, c in enumerate(self.coordinates) if c.effect == effect and seen[i]]
        if not own:
            return 0.0, 1
        size = np.array([self.coordinates[i].role in SIZED for i in own])
        theta, block = self.values[own][size], self.covariance[np.ix_(own, own)]
        scale = np.sqrt(np.diag(block))
        precision = np.linalg.pinv(block / scale[:, None] / scale, rcond=1e-10, hermitian=True) / scale[:, None] / scale
        return float(theta @ precision[np.ix_(size, size)] @ theta), int(size.sum())

    def intervals(self, effect: int) -> dict[str, Interval]:
        """{parameter: (value, low, high)} at 95 % of effect number `effect`, within the parameter's bounds; vectors as
        lists.
        """
        out: dict[str, Interval] = {}
        vectors: dict[str, tuple[list[float], list[float], list[float]]] = {}
        for i, c in enumerate(self.coordinates):
            if c.effect != effect:
                continue
            half = Z95 * np.sqrt(self.covariance[i, i])
            ends = [
                float(np.clip(c.parameter(np.clip(self.values[i] + s * half, *c.ends)), *c.bounds)) for s in (0, -1, 1)
            ]
            ends[1:] = sorted(ends[1:])
            if c.index is None:
                out[c.name] = ends[0], ends[1], ends[2]
            else:
                out[c.name] = vectors.setdefault(c.name, ([], [], []))
                for vector, end in zip(vectors[c.name], ends):
                    vector.append(end)
        return out

    def at_bounds(self, effect: int) -> dict[str, float]:
        """{parameter: bound} of the numbers of effect number `effect` that stand at a bound."""
        found = {
            c.name: c.at_bound(self.point.effects[effect])
            for c in self.coordinates
            if c.effect == effect and c.index is None
        }
        return {name: bound for name, bound in found.items() if bound is not None}


@dataclass(frozen=True, slots=True, eq=False)
class _Freedom:
    """c coordinates to be stepped along. column : Column of them; values : (c,) now; loose : (c,) 1 / standard
    deviation beforehand
    low, high : (c,) bounds; conserved : (k, c) sums of them that stay"""

    column: Column
    values: Floats
    loose: Floats
    low: Floats
    high: Floats
    conserved: Floats

    @staticmethod
    def of(coordinates: list[Coordinate], effects: tuple[Effect, ...], column: Column) -> "_Freedom":
        values = np.array([c.read(effects[c.effect]) for c in coordinates])
        ends = np.array([c.ends for c in coordinates], float).reshape(-1, 2)
        return _Freedom(
            column,
            values,
            np.array([c.loose for c in coordinates]),
            ends[:, 0],
            ends[:, 1],
            conserved_coordinate_sums(coordinates, effects),
        )

    def joined_with(self, other: "_Freedom") -> "_Freedom":
        """Both together."""
        values, worth, low, high = (
            np.r_[getattr(self, name), getattr(other, name)] for name in ("values", "loose", "low", "high")
        )
        return _Freedom(
            join_columns([self.column, other.column]),
            values,
            worth,
            low,
            high,
            block_diag(self.conserved, other.conserved),
        )


def add_term(refinement: Refinement, score: PlatformScore, sensitivities: Sensitivities) -> Refinement:
    """Add a Score's effect as a term to a Refinement, all that is free moved with it.

    Raises ValueError where no share of the step leaves the other effects within what they allow.
    """
    model, k = refinement.model, refinement.point
    column, theta = candidate_column(model, score.candidate, score.node, sensitivities), score.coefficients
    own = None if refinement.column is None else _Freedom.of(refinement.coordinates, k.effects, refinement.column)
    if not len(theta):  # its size is its node's: the rest makes room
        parts = join_columns([c for c in (refinement.column, column) if c is not None])
        step = np.r_[np.zeros(len(refinement.coordinates)), 1.0]
    else:
        by = {p.name: p for p in score.candidate.kind.parameters_at(score.candidate.place)}
        priors = np.array(
            [
                inverse_prior_standard_deviation(by[name], index) if name in by else 0.0
                for name, index, _ in score.candidate.spec.linear
            ]
        )
        low, high = coefficient_bounds(score.candidate.spec)
        new = _Freedom(column, np.zeros(len(theta)), priors, low, high, np.zeros((0, len(theta))))
        free = new if own is None else own.joined_with(new)
        parts, step = free.column, _step(model, free)[0]
        theta = score.candidate.allowed(step[len(refinement.coordinates) :])
        step = np.r_[step[: len(refinement.coordinates)], theta]
    found, beyond = None, "the other effects leave their domain"
    for share in SHARES:  # a large effect is not linear in its numbers: its whole step may lead far beyond it
        known = effects_with_coordinates(
            k.effects, refinement.coordinates, refinement.values + share * step[: len(refinement.coordinates)]
        )
        if known is None:
            continue
        try:
            added = effect_with_valid_place_and_parameters(score.candidate.effect(score.node, share * theta))
        except ValueError as error:  # as sums of several members may be: a smaller share of the step is within bounds
            beyond = str(error)
            continue
        found = operating_point_and_nuisance_moves_after_step(model, step, parts, [*known, added], share)
        if not len(theta) or cost_without_relinearisation(model, *found) <= likelihood_cost(model):
            break
    if found is None:
        raise ValueError(f"{score.candidate.name} at {score.candidate.place}: {beyond}")
    return refine_operating_point(found[0], sensitivities, model)


def operating_point_without_term(refinement: Refinement, number: int) -> OperatingPoint:
    """OperatingPoint of a Refinement without the term of one effect.

    What is free is moved to compensate.
    """
    model = refinement.model
    others = [e for i, e in enumerate(refinement.point.effects) if i != number]
    if refinement.column is None:
        return refinement.point.with_effects(others)
    step = np.array(
        [
            -v if c.effect == number and c.role in SIZED else 0.0
            for c, v in zip(refinement.coordinates, refinement.values)
        ]
    )
    return operating_point_and_nuisance_moves_after_step(model, step, refinement.column, others)[0]


def refine_operating_point(
    point: OperatingPoint, sensitivities: Sensitivities, nearby_model: LinearisedModel | None = None
) -> Refinement:
    """Refine an operating point: cameras, geometry, poses and the admitted effects' parameters together.

    Standing corners are first taken at their covariance; only what they then still miss together, in every frame,
    loosens them. nearby_model : as `linearise` takes it
    """
    return _with_repeated_corner_error(
        refine_at_fixed_repeated_corner_error(replace(point, standing=0.0), sensitivities, nearby_model), sensitivities
    )


def refine_without_term(refinement: Refinement, number: int, sensitivities: Sensitivities) -> Refinement:
    """Refinement without an admitted effect, refined as `refine_operating_point` does."""
    if refinement.point.standing:
        point = operating_point_without_term(refinement, number)
        return refine_operating_point(point, sensitivities, refinement.model)
    return _with_repeated_corner_error(refinement.without_term(number, sensitivities), sensitivities)


def _with_repeated_corner_error(refined: Refinement, sensitivities: Sensitivities) -> Refinement:
    """A refinement, and once more where corners that stand miss it together in every frame."""
    left = repeated_corner_error(refined.point)
    if not left:
        return refined
    return refine_at_fixed_repeated_corner_error(replace(refined.point, standing=left), sensitivities)


def refine_at_fixed_repeated_corner_error(
    point: OperatingPoint, sensitivities: Sensitivities, nearby_model: LinearisedModel | None = None
) -> Refinement:
    """Refine an operating point with the repeated error of standing corners fixed.

    nearby_model : as `linearise` takes it
    """
    model, far = linearise(point, CLIP, nearby_model), True
    for _ in range(MAX_ITERATIONS):
        model = _model_with_fitting_clip(model) if far else model
        coordinates, column = effect_coordinates_and_directions(model, sensitivities)
        freedom = partial(_Freedom.of, coordinates)
        step, covariance = (
            (np.zeros(0), np.zeros((0, 0))) if column is None else _step(model, freedom(point.effects, column))
        )
        new = _try(model, coordinates, step, column)
        if new is None and model.corners.clip == CLIP:
            break
        if new is None:
            model, far = linearise(point, CLIP, model), False
            continue
        point, gained = new
        model = linearise(point, model.corners.clip, model)
        if model.corners.clip > CLIP:
            continue
        if (np.abs(step) < SMALL * np.sqrt(np.diag(covariance))).all() and gained < 1 or gained < ENOUGH:
            break
    if model.corners.clip > CLIP:
        model = linearise(point, CLIP, model)
    return refinement_without_moving(model, sensitivities)


def refinement_without_moving(model: LinearisedModel, sensitivities: Sensitivities) -> Refinement:
    """Refinement of a model's operating point with nothing moved: its optimum only where it was refined before."""
    point = model.point
    coordinates, column = effect_coordinates_and_directions(model, sensitivities)
    if column is None:
        return Refinement(point, model, coordinates, np.zeros(0), np.zeros((0, 0)), None)
    last = _Freedom.of(coordinates, point.effects, column)
    return Refinement(point, model, coordinates, last.values, _step(model, last)[1], column)


def _model_with_fitting_clip(model: LinearisedModel) -> LinearisedModel:
    """The model with corners clipped where few of them lie, so that a fit far from its end does not creep by a few
    standard deviations of a corner at a time; at CLIP in the end."""
    clip, reach = model.corners.clip, model.corners.reach
    if reach > clip or clip > CLIP and reach < clip / 3:
        wide = max(reach if reach > 2 * CLIP else CLIP, CLIP)
        return model if wide == clip else linearise(model.point, wide, model)
    return model


def _step(model: LinearisedModel, free: _Freedom) -> tuple[Floats, Floats]:
    """Step (c,) of coordinates, to a bound at most, and their covariance (c, c), of which bounds know nothing."""
    found = model.linear.project(free.column)
    b, G = found.right - free.loose**2 * free.values, found.gram + np.diag(free.loose**2)
    return bounded_step_and_covariance(b, G, free.values, np.stack([free.low, free.high], axis=1), free.conserved)


def _try(
    model: LinearisedModel, coordinates: list[Coordinate], step: Floats | Integers, column: Column | None
) -> tuple[OperatingPoint, float] | None:
    """(OperatingPoint after as much of the step as lowers the cost, by how much), or None."""
    k, before = model.point, likelihood_cost(model)
    values = np.array([c.read(k.effects[c.effect]) for c in coordinates])
    for share in SHARES:
        effects = effects_with_coordinates(k.effects, coordinates, values + share * step[: len(values)])
        if effects is None:
            continue
        point, nuisances = operating_point_and_nuisance_moves_after_step(
            model, cast(Floats, step), column, effects, share
        )
        gained = before - cost_without_relinearisation(model, point, nuisances)
        if gained >= -SLACK:
            return point, gained
    return None
