"""The platform as a Problem of the diagnosis engine.

Effects are fitted with cameras, geometry and poses.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    PLATFORM,
    SelectionPolicy,
    StatedTerms,
)
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.linear_residual_model import Column, LinearModel
from calib.diagnosis.engine.problem_interface import Wald
from calib.diagnosis.problems.platform import marker_and_thermometer_tolerance_model_and_significance
from calib.diagnosis.problems.platform import platform_lack_of_fit_excess_scatter_and_covariates as remainder
from calib.diagnosis.problems.platform.alternative_candidate_screening import screened_alternatives
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    PlatformCandidate,
    PlatformScore,
    Sensitivities,
    effect_coordinates_and_directions,
)
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    Refinement,
    add_term,
    refine_operating_point,
    refine_without_term,
    refinement_without_moving,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import (
    CLOSURES,
    CORNERS,
    LinearisedModel,
    linearise,
)
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import cross_validate_effects
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import candidate_column, score_candidates
from calib.diagnosis.problems.platform.smooth_function_columns_of_struts_cameras_and_markers import (
    model_with_smooth_functions,
    smooth_function_pixels_and_weights,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlatformFit(FieldSummaryRepr):
    """refined : Refinement of the admitted effects; terms : the candidates that they come from, in the same order."""

    refined: Refinement
    terms: tuple[PlatformCandidate, ...] = ()


PlatformSelection = Selection[PlatformFit, PlatformCandidate]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlatformProblem(FieldSummaryRepr):
    """point : OperatingPoint with nothing admitted; candidates : asked for; policy : thresholds; given : what is said
    beforehand
    tolerant : whether what tolerances may do on their own is among the nuisances
    sensitivities : of the effects, derivatives held from search to search"""

    point: OperatingPoint
    candidates: list[PlatformCandidate]
    policy: SelectionPolicy = PLATFORM
    given: StatedTerms = StatedTerms()
    tolerant: bool = False
    sensitivities: Sensitivities = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensitivities", Sensitivities(self.point))

    def start(self) -> PlatformFit:
        return PlatformFit(refine_operating_point(self.point, self.sensitivities))

    def tolerances_explain(self, fit: PlatformFit, best: PlatformScore | None) -> bool:
        if self.tolerant:
            return False
        model = fit.refined.marginalised
        found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(model, self.sensitivities)
        if found is None:
            return False
        seen = found.projected(model)
        if not marker_and_thermometer_tolerance_model_and_significance.tolerances_explain_residuals(seen, found.sigma):
            return False
        return (
            best is None
            or marker_and_thermometer_tolerance_model_and_significance.log_likelihood_ratio_with_tolerances(
                seen, found.sigma
            )
            > float(best.raw_delta_bic(model.size))
        )

    def with_tolerances(self) -> Self:
        other = replace(self, tolerant=True)
        other.sensitivities.pixels.update(self.sensitivities.pixels)
        return other

    def terms(self, fit: PlatformFit) -> list[PlatformCandidate]:
        return list(fit.terms)

    def admissible(self, fit: PlatformFit) -> list[PlatformCandidate]:
        once = {(c.name, c.place) for c in fit.terms if c.kind.once}
        return [c for c in self.candidates if (c.name, c.place) not in once]

    def size(self, fit: PlatformFit) -> int:
        return fit.refined.model.size

    def residual(self, fit: PlatformFit) -> LinearisedModel:
        return self.model_beyond_tolerances(fit.refined.marginalised)

    def without_term(self, fit: PlatformFit, number: int) -> LinearisedModel:
        return self.marginalised(self.model_without_term(fit, number))

    def model_without_term(self, fit: PlatformFit, number: int) -> LinearisedModel:
        """LinearisedModel without an admitted effect, the others' parameters not among the nuisances yet. What moves
        corners is first taken up by cameras and poses as far as they can: corners that it moved far would be clipped,
        and what it does would no longer be linear."""
        k = fit.refined.point
        if fit.terms[number].seen_alone:
            return fit.refined.without_term(number, self.sensitivities).model
        return linearise(
            k.with_effects(e for i, e in enumerate(k.effects) if i != number), nearby_model=fit.refined.model
        )

    def marginalised(self, model: LinearisedModel) -> LinearisedModel:
        """LinearisedModel with the parameters of the effects admitted there among the nuisances."""
        _, column = effect_coordinates_and_directions(model, self.sensitivities)
        return self.model_beyond_tolerances(model if column is None else model.marginalise(column))

    def model_beyond_tolerances(self, model: LinearisedModel) -> LinearisedModel:
        """LinearisedModel with what tolerances do among the nuisances, where this problem is tolerant."""
        found = (
            marker_and_thermometer_tolerance_model_and_significance.tolerance_model(model, self.sensitivities)
            if self.tolerant
            else None
        )
        return (
            model
            if found is None
            else marker_and_thermometer_tolerance_model_and_significance.model_with_tolerances(model, found)
        )

    def covered(self, fit: PlatformFit, number: int, left: list[LackOfFit]) -> LinearisedModel:
        model = self.model_without_term(fit, number)
        whole = not fit.terms[number].site.is_axis
        return self.marginalised(
            model_with_smooth_functions(model, *smooth_function_pixels_and_weights(model, left, whole))
        )

    def linear(self, model: LinearisedModel) -> LinearModel:
        return model.linear

    def search(
        self,
        model: LinearisedModel,
        candidates: list[PlatformCandidate],
        least: float = -np.inf,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[PlatformScore]:
        return score_candidates(model, candidates, self.sensitivities.at(model.point), least, progress)

    def screen_alternatives(
        self, fit: PlatformFit, progress: Callable[[int, int], None] | None = None
    ) -> list[list[PlatformCandidate]] | None:
        if self.tolerant or fit.refined.column is None or any(c.seen_alone for c in fit.terms):
            return None  # what shows in images alone is no longer linear where it is taken away
        without = [self.without_term(fit, number) for number in range(len(fit.terms))]
        sensitivities = self.sensitivities.at(fit.refined.point)
        return screened_alternatives(fit.refined, fit.terms, without, self.candidates, sensitivities, progress)

    def rescored(self, model: LinearisedModel, fit: PlatformFit, number: int) -> PlatformScore:
        return self.search(model, [fit.terms[number]])[0]

    def is_at_other_node(self, fit: PlatformFit, number: int, score: PlatformScore) -> bool:
        effect, candidate = fit.refined.point.effects[number], fit.terms[number]
        unfitted = [
            p.name for p in candidate.kind.parameters if p.role in ("moment", "choice") and p.name in score.node
        ]
        return any(getattr(effect, name) != score.node[name] for name in unfitted)

    def column(self, model: LinearisedModel, score: PlatformScore) -> Column:
        column = candidate_column(model, score.candidate, score.node, self.sensitivities.at(model.point))
        theta = score.coefficients if len(score.coefficients) else np.ones(1)
        return Column(column.parts) @ theta[:, None]

    def add_term(self, fit: PlatformFit, score: PlatformScore) -> PlatformFit:
        refined = add_term(fit.refined, score, self.sensitivities.at(fit.refined.point))
        return PlatformFit(refined, (*fit.terms, score.candidate))

    def remove_term(self, fit: PlatformFit, number: int) -> PlatformFit:
        return PlatformFit(
            refine_without_term(fit.refined, number, self.sensitivities), fit.terms[:number] + fit.terms[number + 1 :]
        )

    def exchange_term(self, fit: PlatformFit, number: int, score: PlatformScore) -> PlatformFit:
        model = self.model_without_term(fit, number)
        refined = add_term(
            refinement_without_moving(model, self.sensitivities), score, self.sensitivities.at(model.point)
        )
        return PlatformFit(refined, (*fit.terms[:number], *fit.terms[number + 1 :], score.candidate))

    def in_place(self, fit: PlatformFit, number: int) -> PlatformFit:
        k = fit.refined.point
        order = [*k.effects[:number], k.effects[-1], *k.effects[number:-1]]
        terms = (*fit.terms[:number], fit.terms[-1], *fit.terms[number:-1])
        return PlatformFit(refine_operating_point(k.with_effects(order), self.sensitivities, fit.refined.model), terms)

    def wald(self, fit: PlatformFit, number: int) -> Wald:
        return Wald(*fit.refined.wald(number))

    def likelihood_ratio(self, fit: PlatformFit, other: PlatformFit) -> float:
        return fit.refined.likelihood(other.refined) - other.refined.likelihood(fit.refined)

    def cross_validations(self, fit: PlatformFit, numbers: list[int]) -> list[CrossValidation]:
        return [cross_validate_effects(fit.refined, {number}, self.block(fit.terms[number])) for number in numbers]

    def block(self, candidate: PlatformCandidate) -> int:
        """Where a candidate shows: CORNERS where it changes only what is seen or nothing was commanded, else
        CLOSURES.
        """
        return CORNERS if candidate.seen_alone or not self.point.axes else CLOSURES

    def lack_of_fit(self, model: LinearisedModel, place: Place | None = None) -> list[LackOfFit]:
        return (
            remainder.find_lack_of_fit_by_place(model)
            if place is None
            else remainder.find_lack_of_fit_by_place(model, place, self.policy.alpha)
        )

    def within(self, left: LackOfFit, place: Place) -> bool:
        return remainder.is_lack_of_fit_at_place(left, place)
