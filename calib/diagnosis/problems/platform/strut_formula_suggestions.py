"""Formula suggestions for unlisted effects of struts.

For what the catalogue does not explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.certification.platform_certification import ignore_progress
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import (
    cross_validation_folds_of_frames,
    held_out_residuals,
    summed_gain_in_standard_errors,
)
from calib.diagnosis.engine.formula_search_for_unexplained_residuals import Formula, Library, Search
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import FrameProducts, Reduced
from calib.diagnosis.engine.linear_residual_model import LinearModel
from calib.diagnosis.engine.problem_interface import Progress
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    AGREE,
    GAIN,
    NAME,
    Suggestion,
    formula_quantity_names,
    formula_text,
    library_of_quantities,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import effect_coordinates_and_directions
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import (
    CLOSURES,
    LinearisedModel,
    linearise,
)
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    residual_change_column_with_only_effects,
)
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import axis_elongation_inner_products
from calib.diagnosis.problems.platform.platform_problem import PlatformFit, PlatformProblem
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.unmodelled_curve_and_formula_quantities import POSE
from rig.effects.texts.effect_file_from_formula import Written
from rig.model.arm_hands_effect_places_and_tolerances import Place

SEVERAL = 3  # struts that are unknown, from which all alike and the platform are asked as well


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Where a formula may act. place; struts : their indices; directions : (F, axes, a) m by which struts lengthen with
    each direction
    library : Library."""

    place: str
    struts: list[int]
    directions: Floats
    library: Library

    def products(self, model: LinearisedModel) -> FrameProducts:
        """FrameProducts of the directions."""
        axes, D = axis_elongation_inner_products(model), np.swapaxes(self.directions, 1, 2)
        return FrameProducts(
            (D @ axes.beta[..., None])[..., 0], D @ axes.gamma @ self.directions, D @ axes.kappa, axes.half
        )

    def floor(self, model: LinearisedModel) -> float:
        """Share of the weights' variance that is the poses' own noise."""
        own = model.strut_noise()[:, self.struts]
        return float(np.mean(1 - model.closures.scatter[self.struts] ** 2 / own))

    def deviation(self, formula: Formula) -> Floats:
        """(F, axes, q) m by which struts lengthen with each of a Formula's coefficients, in units of its library's
        scales.
        """
        rows = np.arange(len(self.directions))
        return np.concatenate([self.directions @ self.library.weights(atom, rows) for atom in formula.atoms], axis=2)

    def written(self, formula: Formula) -> Written:
        """Written of a Formula here."""
        return formula_text(formula, self.library, "strut", self.place == "rig" and not self.library.apart)


FORMULA_PLACES = ("strut", "rig")  # kinds of place for whose remainder formulas are suggested


def suggest_strut_formulas(
    problem: PlatformProblem, fit: PlatformFit, unexplained: list[LackOfFit], progress: Progress | None = None
) -> list[Suggestion]:
    """Suggested formulas ([Suggestion]) for the unexplained part of struts.

    Of single struts, of all alike, or of the platform.
    progress : called with (label, done, of), or None
    """
    k = fit.refined.point
    places = list(dict.fromkeys(u.place for u in unexplained if u.place.kind in FORMULA_PLACES))
    model = problem.residual(fit)
    if not k.axes or not places:
        return []
    report = progress or ignore_progress
    struts = [i for i in range(k.axes) if k.places[i] in places]
    sites = [_of_strut(k, i) for i in struts] + (
        [_of_all(k), _of_platform(k)] if len(struts) >= SEVERAL or Place("rig") in places else []
    )
    tried: list[Found | None] = []
    for site in sites:
        report("trying formulas", len(tried), len(sites))
        tried.append(_found(problem, fit, model, site))
    each = [found for site, found in zip(sites, tried) if found is not None and len(site.struts) == 1]
    whole = [found for site, found in zip(sites, tried) if found is not None and len(site.struts) > 1]
    each = min([each, *([one] for one in whole)], key=lambda several: _description(problem, fit, several))
    report("trying formulas", len(sites), len(sites))
    return [s for found in each if (s := _suggested(problem, fit, *found)) is not None]


def _of_strut(k: OperatingPoint, i: int) -> Site:
    return Site(
        str(k.places[i]),
        [i],
        np.broadcast_to(np.eye(k.axes)[:, [i]], (len(k.t), k.axes, 1)),
        library_of_quantities(k.motion(()), i),
    )


def _of_all(k: OperatingPoint) -> Site:
    return Site(
        "rig",
        list(range(k.axes)),
        np.broadcast_to(np.eye(k.axes), (len(k.t), k.axes, k.axes)),
        library_of_quantities(k.motion(()), None, k.axes),
    )


def _of_platform(k: OperatingPoint) -> Site:
    motion = k.motion(())
    ways = [k.swayed(motion.tangents(np.broadcast_to(direction, (len(k.t), 6)))) for direction in np.eye(len(POSE))]
    return Site(
        "rig", list(range(k.axes)), np.stack(ways, axis=2), library_of_quantities(motion, None, len(POSE), True)
    )


Found = tuple[Site, Formula, LinearisedModel]


def _found(problem: PlatformProblem, fit: PlatformFit, model: LinearisedModel, site: Site) -> Found | None:
    """(Site, Formula, the model that it was found on), None where none is worth it: sought twice, the second time with
    struts weighed as they scatter about the first."""
    first = _best(model, site)
    if first is None:
        return None
    repeated = _model_with_formula(problem, fit, site, first)
    second = _best(repeated, site)
    return None if second is None else (site, second, repeated)


def _best(model: LinearisedModel, site: Site) -> Formula | None:
    return Search(site.library, Reduced.of(site.products(model), np.arange(model.frames)), site.floor(model)).best()


def _effect(site: Site, formula: Formula) -> Effect:
    form = site.written(formula)
    return form.kind(NAME)(site.place, **form.values)


def _description(problem: PlatformProblem, fit: PlatformFit, several: list[Found]) -> float:
    """Minus twice the log likelihood with formulas, struts weighed as they scatter beside them, and what the formulas
    cost.
    """
    k = fit.refined.point
    effects = [_effect(site, formula) for site, formula, _ in several]
    new, _ = _with(problem, fit, k.with_effects((*k.effects, *effects)))
    return (
        new.linear.cost()
        - 2 * float(np.linalg.slogdet(new.closures.W)[1].sum())
        + sum(formula.cost for _, formula, _ in several)
    )


def _with(problem: PlatformProblem, fit: PlatformFit, point: OperatingPoint) -> tuple[LinearisedModel, LinearisedModel]:
    """(LinearisedModel at a point with more effects, the parameters of those admitted in a fit among its nuisances; the
    same without).
    """
    bare = linearise(point)
    coordinates, column = effect_coordinates_and_directions(bare, problem.sensitivities)
    others = [i for i, c in enumerate(coordinates) if c.effect < len(fit.refined.point.effects)]
    new = bare.marginalise(column.take(others)) if others and column is not None else bare
    return problem.model_beyond_tolerances(new), bare


def _model_with_formula(problem: PlatformProblem, fit: PlatformFit, site: Site, formula: Formula) -> LinearisedModel:
    """LinearisedModel in which nothing of a Formula is taken off, and struts count for what they scatter beside it."""
    k = fit.refined.point
    new, bare = _with(problem, fit, k.with_effects((*k.effects, _effect(site, formula))))
    return replace(new, linear=_grown(new.linear, residual_change_column_with_only_effects(bare, k.effects).parts))


def _grown(linear: LinearModel, parts: Sequence[Floats | None]) -> LinearModel:
    """LinearModel with parts (one (m, 1) for each block, None for nothing) added to the residuals, nuisances taken out
    again. What a block knows beforehand besides, tolerances, stays as it is: a part may end before it."""
    added = [np.zeros(len(block.residual)) for block in linear.blocks]
    for rows, part in zip(added, parts):
        if part is not None:
            rows[: len(part)] = part[:, 0]
    z = np.sum([Q.T @ rows for Q, rows in zip(linear.columns.whole, added)], axis=0)
    blocks = tuple(
        replace(block, residual=block.residual + rows - Q @ z)
        for block, rows, Q in zip(linear.blocks, added, linear.columns.whole)
    )
    return replace(linear, blocks=blocks)


def _suggested(
    problem: PlatformProblem, fit: PlatformFit, site: Site, formula: Formula, model: LinearisedModel
) -> Suggestion | None:
    """Suggestion of a Formula, refined with all that is free; None where stretches chosen without do not gain by
    such.
    """
    fold = cross_validation_folds_of_frames(model.frames, has_sudden_effects=False)
    products, floor = site.products(model), site.floor(model)
    chosen = [
        Search(site.library, Reduced.on(model.linear, products, fold != h), floor).best() for h in np.unique(fold)
    ]
    residuals = tuple(block.residual for block in model.linear.blocks)
    without = held_out_residuals(model.linear, residuals, fold).frames[CLOSURES]
    withit = without.copy()
    rows = np.repeat(fold, model.point.axes)
    for h, one in zip(np.unique(fold), chosen):
        if one is not None:
            marginalised = model.marginalise(model.lengthened(site.deviation(one)))
            predicted = held_out_residuals(
                marginalised.linear, tuple(block.residual for block in marginalised.linear.blocks), fold, h
            ).frames[CLOSURES]
            withit[rows == h] = predicted[rows == h]
    squares = [(left.reshape(model.frames, -1) ** 2).sum(axis=1) for left in (without, withit)]
    gain = summed_gain_in_standard_errors(squares[0] - squares[1])
    if gain < GAIN or sum(one is not None for one in chosen) < AGREE * len(chosen):
        return None
    k, struts = fit.refined.point, site.struts
    refined = refine_operating_point(k.with_effects((*k.effects, _effect(site, formula))), problem.sensitivities)
    inverse = np.linalg.inv(model.closures.W)
    before, after = (
        float(np.sqrt(np.mean((inverse @ left.reshape(model.frames, -1, 1))[:, struts] ** 2)))
        for left in (without, withit)
    )
    noise = float(np.sqrt(np.mean((model.strut_noise() - model.closures.scatter**2)[:, struts])))
    return Suggestion(
        site.place,
        site.written(formula),
        refined.point.effects[-1],
        refined.intervals(len(k.effects)),
        before,
        after,
        noise,
        "m",
        gain,
        tuple(formula_quantity_names(one, site.library) for one in chosen),
        formula.length,
    )
