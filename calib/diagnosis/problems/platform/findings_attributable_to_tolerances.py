"""Findings attributable to tolerances (beyond chance, but no larger than these may cause), separated as remarks."""

from dataclasses import replace

import numpy as np
import scipy

from calib.diagnosis.engine.candidate_score import Score
from calib.diagnosis.engine.cross_validation_and_chance import Z95
from calib.diagnosis.engine.finding_confirmation_against_alternatives import Finding, is_significant
from calib.diagnosis.engine.lack_of_fit_by_smooth_functions import LackOfFit
from calib.diagnosis.engine.linear_model import Column, Projection, join_columns
from calib.diagnosis.engine.selection_candidates_thresholds_and_outliers import C
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Remark, Tolerable, Value
from calib.diagnosis.problems.platform.effect_candidates import PlatformCandidate, effect_context
from calib.diagnosis.problems.platform.effect_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_residuals import CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.marker_and_thermometer_tolerance_columns import (
    TOGETHER,
    SignificantTolerance,
    ToleranceModel,
    model_with_tolerances,
    share_not_explained_by_tolerances,
    significant_tolerances,
    tolerance_model,
)
from calib.diagnosis.problems.platform.misplaced_markers_and_held_out_validation import residual_change_column
from calib.diagnosis.problems.platform.platform_problem import PlatformFit, PlatformProblem, PlatformSelection
from calib.diagnosis.problems.platform.scores_of_all_candidates import candidate_column
from calib.diagnosis.problems.platform.simultaneous_refinement import Refinement
from calib.diagnosis.problems.platform.temperature_alternatives_of_findings import WARM
from rig.array_and_json_types import Floats
from rig.model.places_and_tolerances import STILL

LASTING = ("image position", "place on the marker")  # what is left and depends on these is the same in every frame
LASTING_VIEWS = ("map", "outward", "markers", "targets")  # effects that residuals show so are, too
REASON_TOGETHER = "the tolerances of printed markers, corner finder and thermometers"
MOST = 2.0  # of what is tolerated, that a kind of it is taken to vary by
ROUNDS, SETTLED = 100, 1e-3  # of the fixed point; the part of what is tolerated by which it may still change


def separate_tolerable_findings(
    problem: PlatformProblem, selection: PlatformSelection, unexplained: list[LackOfFit]
) -> tuple[PlatformSelection, list[LackOfFit], Tolerable]:
    """(Selection of findings beyond tolerances, unexplained beyond them, Remarks on those that are tolerable)."""
    fit, known = selection.fit, problem.tolerant
    if not known and not selection.findings and not unexplained:
        return selection, unexplained, Tolerable()
    matters, small = [], []
    for f in selection.findings:
        reason = None if problem.given.holds(f.score.candidate) else _reason(problem, selection, f, known)
        if reason is None:
            matters.append(f)
        else:
            small.append((f, reason))
    model = fit.refined.marginalised
    found = tolerance_model(model, problem.sensitivities) if known or unexplained else None
    stays = unexplained if known or found is None else problem.lack_of_fit(model_with_tolerances(model, found))
    gone = [(u, REASON_TOGETHER) for u in unexplained if not any(u.place == v.place for v in stays)]
    tiny = [
        (u, STILL.reason)
        for u in stays
        if u.unit == "px" and set(u.depends_on) & set(LASTING) and u.magnitude < STILL.limit
    ]
    stays = [u for u in stays if not any(u is v for v, _ in tiny)]
    sites = significant_tolerances(model, found) if known and found is not None else []
    return replace(selection, findings=matters), stays, Tolerable(small, [*gone, *tiny], [_remark(s) for s in sites])


def _remark(slight: SignificantTolerance) -> Remark:
    """Remark of what a tolerance was seen to be."""
    parameters, at, ends = {}, 0, Z95 * slight.sigma
    for name, unit, count in slight.site.parameters:
        rows = slice(at, at + count)
        low, value, high = ((slight.values + s * ends)[rows].tolist() for s in (-1, 0, 1))
        parameters[name] = Value(value, unit, [low, high]) if count > 1 else Value(value[0], unit, [low[0], high[0]])
        at += count
    return Remark(slight.site.effect, slight.site.place, parameters, slight.site.tolerance.reason, slight.p_value)


def _reason(
    problem: PlatformProblem, selection: PlatformSelection, finding: Finding[PlatformCandidate], known: bool
) -> str | None:
    """Why a Finding is a remark, None where it matters. known : whether tolerances were among the nuisances when it was
    found
    """
    fit, kind = selection.fit, selection.fit.terms[finding.number].kind
    if (
        kind.view in LASTING_VIEWS
        and problem.block(fit.terms[finding.number]) == CORNERS
        and _corner_displacement(fit, finding.number) < STILL.limit
    ):
        return STILL.reason
    if known:
        return None
    model = problem.without_term(fit, finding.number)
    found = tolerance_model(model, problem.sensitivities)
    if found is None:
        return None
    score, kept = finding.score, problem.sensitivities.at(model.point)
    share = share_not_explained_by_tolerances(
        model, found, candidate_column(model, score.candidate, score.node, kept), not len(score.coefficients)
    )
    if is_significant(_weaken_score(score, share), selection.asked, problem.size(fit), problem.policy):
        return None
    own = (
        s.tolerance.reason for s in found.sites if (s.effect, s.place) == (score.candidate.name, score.candidate.place)
    )
    return next(own, REASON_TOGETHER)


def _weaken_score(score: Score[C], share: float) -> Score[C]:
    """A Score of which tolerances leave a share of its delta chi-square."""
    delta = score.delta_chi2 * min(share, 1.0)
    chance = float(scipy.special.chdtrc(score.freedom, delta))
    return score if share >= 1 else replace(score, delta_chi2=delta, p_value=max(score.p_value, chance))


def _corner_displacement(fit: PlatformFit, number: int) -> float:
    """px RMS by which an admitted effect moves the corners that it moves at all, cameras and poses having taken what
    they can.
    """
    k, model = fit.refined.point, fit.refined.model
    others = [e for i, e in enumerate(k.effects) if i != number]
    square = model.linear.project(residual_change_column(model, others)).gram[0, 0]
    touched = np.count_nonzero((k.pixels() != k.pixels(tuple(others))).any(axis=1))
    return float(model.corner_noise() * np.sqrt(max(square, 0.0) / max(touched, 1)))


def widen_intervals_by_temperature_logs_and_tolerances(
    refinement: Refinement, sensitivities: Sensitivities
) -> Refinement:
    """Refinement with intervals (its covariance) widened by errors of temperature logs and by tolerances."""
    added = [
        half
        for half in (
            parameter_errors_by_temperature_logs(refinement),
            parameter_errors_by_tolerances(refinement, sensitivities),
        )
        if half is not None
    ]
    return replace(refinement, covariance=refinement.covariance + sum(half @ half.T for half in added))


def parameter_errors_by_temperature_logs(refinement: Refinement) -> Floats | None:
    """Errors (c, k) of fitted coordinates per standard deviation of the temperature logs' errors, or None."""
    k, sensors, parts = refinement.point, refinement.point.sensors, []
    if sensors is None or refinement.column is None:
        return None
    channels = {
        next(name for name in names if name in sensors.channels)
        for e in k.effects
        if type(e) in WARM
        for names in type(e).follows(e.place, effect_context(k))
    }
    for channel in sorted(channels & k.log_errors.keys()):
        for error in k.log_errors[channel].T:
            course = {**sensors.channels, channel: sensors.channels[channel] + error}
            parts += [_moved(refinement.model, replace(k, sensors=replace(sensors, channels=course)))]
    if not parts:
        return None
    own = len(refinement.coordinates)
    both = join_columns([Column(refinement.column.parts), *parts])
    return refinement.covariance @ refinement.model.linear.project(both).gram[:own, own:]


def parameter_errors_by_tolerances(refinement: Refinement, sensitivities: Sensitivities) -> Floats | None:
    """Errors (c, q) of fitted coordinates per standard deviation of manufacturing tolerances, or None.
    What an effect is the size of is nothing that it
    is off by.
    """
    found = tolerance_model(refinement.marginalised, sensitivities)
    if found is None or refinement.column is None:
        return None
    linear = refinement.model.linear
    across = (
        found.with_column(refinement.column)
        - linear.project(refinement.column).onto.T @ found.projected(refinement.model).onto
    )
    off = (
        refinement.covariance
        @ across
        * tolerance_sigmas_from_residuals(found.projected(refinement.marginalised), found)
    )
    for i, c in enumerate(refinement.coordinates):
        effect = refinement.point.effects[c.effect]
        for site in found.sites:
            if (site.effect, site.place) == (effect.name, effect.place):
                off[i, site.columns] = 0.0
    return off


def tolerance_sigmas_from_residuals(projection: Projection, tolerances: ToleranceModel) -> Floats:
    """Tolerance sigmas (q,) estimated from residuals, kind by kind, at the most MOST times the stated ones

    Source: MacKay, Bayesian interpolation, Neural Computation 4, 1992, sec. 4
    """
    share = np.ones(tolerances.kinds.max() + 1)
    for _ in range(ROUNDS):
        sigma = tolerances.sigma * share[tolerances.kinds]
        on = np.flatnonzero(sigma)
        width = sigma[on]
        inverse = np.linalg.inv(np.eye(len(on)) + width[:, None] * projection.gram[np.ix_(on, on)] * width)
        sizes, known = share[tolerances.kinds[on]] * (inverse @ (width * projection.right[on])), 1 - np.diag(inverse)
        new = share.copy()
        for kind in np.unique(tolerances.kinds[on]):
            own = tolerances.kinds[on] == kind
            if kind != TOGETHER:
                new[kind] = min(np.sqrt((sizes[own] ** 2).sum() / max(known[own].sum(), 1e-9)), MOST)
        new[new < SETTLED] = 0.0
        if np.abs(new - share).max() < SETTLED:
            break
        share = new
    return tolerances.sigma * share[tolerances.kinds]


def _moved(model: LinearisedModel, off: OperatingPoint) -> Column:
    """Column (1) of what another OperatingPoint does to corners and closures."""
    k = model.point
    out = Column((None, model.nothing(1)))
    if k.seen is not None:
        out = out + Column(model.fold((off.pixels() - k.pixels())[..., None]).parts)
    return out + model.lengthened((off.effective() - k.effective())[..., None]) if k.axes else out
