"""Alternatives of a platform's findings: errors within tolerances, and temperature effects.

Findings no larger than tolerances may cause are separated as remarks; temperature effects, where a temperature log is
missing or wrong, are added to the alternatives.
"""

import inspect
from dataclasses import replace

import numpy as np
import scipy

from calib.diagnosis.engine.candidate_scores_and_their_significance import Alternative, Score
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C
from calib.diagnosis.engine.choice_between_whole_machine_and_axis_terms import is_significant_alone_or_with_other_axes
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Z95
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.linear_residual_model import Column, Projection, column_cosine, join_columns
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding, is_finding_significant
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import time_cosines
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Remark, Tolerable, Value
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    PlatformCandidate,
    PlatformScore,
    Sensitivities,
    effect_context,
    lacks_temperature_log,
    platform_candidate,
)
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.marker_and_thermometer_tolerance_model_and_significance import (
    SignificantTolerance,
    model_with_tolerances,
    share_not_explained_by_tolerances,
    significant_tolerances,
    tolerance_model,
    tolerance_sigmas_from_residuals,
)
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    residual_change_column_with_only_effects,
)
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import candidate_column
from calib.diagnosis.problems.platform.platform_problem import PlatformFit, PlatformProblem, PlatformSelection
from calib.diagnosis.problems.platform.smooth_function_columns_of_struts_cameras_and_markers import SLOW
from rig.array_and_json_types import Floats
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import REFERENCE_TEMPERATURE, Effect
from rig.effects.framework.effect_base_class import Candidate as EffectCandidate
from rig.model.arm_hands_effect_places_and_tolerances import AXES, STILL, Place
from rig.recording.recording_folder import Sensors

WARM = tuple(
    kind
    for kind in ALL  # those that follow a temperature
    if inspect.getattr_static(kind, "follows") is not inspect.getattr_static(Effect, "follows")
)
STEP = 1e-5  # 1/K
SIZES = 200  # of a coefficient that are tried, over DECADES about what rigs show
DECADES = 1.0  # beyond
TAKEN = 0.5  # of what a finding explains, that temperatures must explain to be its alternative


def add_temperature_effects_as_alternatives_of_findings(
    problem: PlatformProblem, selection: PlatformSelection
) -> PlatformSelection:
    """Add to each finding of a Selection, as alternatives, the temperature effects that explain it as well."""
    return _noisy_log_temperature_alternatives(problem, _unlogged_temperature_alternatives(problem, selection))


def _unlogged_temperature_alternatives(problem: PlatformProblem, selection: PlatformSelection) -> PlatformSelection:
    """Selection in which every finding that could as well be an effect of a temperature, had it run as some smooth
    function of time, has that effect among its alternatives, at its own place or at the whole machine; effects whose
    temperature was logged are not asked for."""
    k = selection.fit.refined.point
    kinds = [kind for kind in WARM if (k.axes if kind.stage != "view" else k.seen is not None)]
    findings = []
    for f in selection.findings:
        requested = [
            (kind, place)
            for kind in kinds
            for place in _places(kind, f.score.candidate.place)
            if lacks_temperature_log(k, kind.follows(place, effect_context(k))) and _acts_if_warm(k, kind, place)
        ]
        findings.append(_with_temperature_alternatives(problem, selection, f, requested) if requested else f)
    return replace(selection, findings=findings)


def _acts_if_warm(k: OperatingPoint, kind: type[Effect], place: str) -> bool:
    """Whether an effect may act on a machine, were its temperatures logged."""
    if kind.stage == "view":
        return True
    warmth = {name: np.full(2, REFERENCE_TEMPERATURE) for name, *_ in kind.follows(place, effect_context(k))}
    known = replace(k, sensors=Sensors(np.array([k.t.min(), k.t.max()]), warmth))
    return kind(place, **{kind.parameters[0].name: STEP}).needs(known.motion(())) is None


def _with_temperature_alternatives(
    problem: PlatformProblem,
    selection: PlatformSelection,
    finding: Finding[PlatformCandidate],
    requested: list[tuple[type[Effect], str]],
) -> Finding[PlatformCandidate]:
    model, alternatives = problem.model_without_term(selection.fit, finding.number), list(finding.alternatives)
    alone = problem.marginalised(model)
    own = finding.score.delta_chi2 * finding.score.dispersion
    for kind, place in requested:
        warm = problem.marginalised(model.marginalise(_courses(model, kind, place)))
        delta = alone.linear.cost() - warm.linear.cost()
        significant = is_finding_significant(problem, finding, warm, selection.fit, selection.candidate_count)
        if significant or delta < TAKEN * own:
            continue
        candidate = platform_candidate(EffectCandidate(kind, place, [{}], []))
        score = Score(candidate, {}, np.zeros(0), delta, 1.0, SLOW, 1.0, 1.0, np.zeros(1))
        behind = own - delta - (finding.score.freedom - SLOW) * np.log(model.size)
        alternatives.append(Alternative(score, behind, float(np.sqrt(np.clip(delta / own, 0, 1)))))
    return replace(finding, alternatives=alternatives)


def _noisy_log_temperature_alternatives(problem: PlatformProblem, selection: PlatformSelection) -> PlatformSelection:
    """The same of effects whose temperature was logged, had it run as its log's own errors allow; not those listed by
    what the log says.
    """
    k, findings = selection.fit.refined.point, []
    warm = [c for c in problem.candidates if c.kind in WARM and _channels(k, c) & k.log_errors.keys()]
    for f in selection.findings:
        own = f.score.candidate
        listed = {(own.name, own.place), *((a.score.candidate.name, a.score.candidate.place) for a in f.alternatives)}
        requested = [c for c in warm if c.place in _places(c.kind, own.place) and (c.name, c.place) not in listed]
        if requested:
            model = problem.without_term(selection.fit, f.number)
            found = [
                (s, f.score.evidence(model.size) - s.evidence(model.size))
                for c in requested
                if (s := _by_errors(model, c)) is not None
            ]
            more = [
                Alternative(s, behind, _cosine(problem, model, f.score, s))
                for s, behind in found
                if behind < problem.policy.alike
            ]
            f = replace(f, alternatives=sorted([*f.alternatives, *more], key=lambda a: a.behind))
        findings.append(f)
    return replace(selection, findings=findings)


def _places(kind: type[Effect], place: str) -> list[str]:
    """Where an effect may sit that looks like a finding at a place: all over, or just there."""
    at = Place.parse(place).kind
    own = at in kind.places or (at in AXES and "axis" in kind.places)
    return [whole for whole in kind.places if whole not in ("axis", "camera")] + [place] * (own and " " in place)


def _courses(model: LinearisedModel, kind: type[Effect], place: str) -> Column:
    """Column (SLOW) of an effect under temperatures that are cosines of time."""
    k, parts = model.point, []
    order = np.argsort(k.t)
    logged = {name: k.sensors.at(k.t[order], name) for name in k.sensors.channels} if k.sensors is not None else {}
    for course in time_cosines(k.t, SLOW).T:
        warmth = {
            channels[0]: REFERENCE_TEMPERATURE + course[order] for channels in kind.follows(place, effect_context(k))
        }
        parts.append(_per_kelvin(model, kind, place, Sensors(k.t[order], {**logged, **warmth})))
    return join_columns(parts)


def _per_kelvin(model: LinearisedModel, kind: type[Effect], place: str, sensors: Sensors) -> Column:
    """Column (1) of an effect under temperatures, per unit of its coefficient."""
    k = model.point
    known, effect = replace(k, sensors=sensors), kind(place, **{kind.parameters[0].name: STEP})
    if kind.stage == "view":
        return model.fold(((known.pixels((*k.effects, effect)) - known.pixels(k.effects)) / STEP)[..., None])
    return model.lengthened((effect.deviation(known.motion(())) / STEP)[..., None])


def _channels(k: OperatingPoint, candidate: PlatformCandidate) -> set[str]:
    """The logged channels that a candidate follows."""
    logged = k.sensors.channels if k.sensors is not None else {}
    return {
        next(name for name in names if name in logged)
        for names in candidate.kind.follows(candidate.place, effect_context(k))
    }


def _by_errors(model: LinearisedModel, candidate: PlatformCandidate) -> PlatformScore | None:
    """Score of an effect of a temperature whose log is off by its own errors, each as likely as it is large; None where
    it explains nothing.

    Source of the likelihood: Fuller, Measurement error models, 1987, ch. 2
    """
    k, kind, place = model.point, candidate.kind, candidate.place
    if k.sensors is None:
        return None
    followed, parts = _channels(k, candidate), [_per_kelvin(model, kind, place, k.sensors)]
    cold = dict.fromkeys(followed, np.full(len(k.sensors.t), REFERENCE_TEMPERATURE))
    for channel in sorted(followed & k.log_errors.keys()):
        for error in k.log_errors[channel].T:
            off = {**k.sensors.channels, **cold, channel: REFERENCE_TEMPERATURE + error}
            parts.append(_per_kelvin(model, kind, place, replace(k.sensors, channels=off)))
    seen, parameter = model.linear.project(join_columns(parts)), kind.parameters[0]
    sizes = np.geomspace(parameter.usual[0] / 10**DECADES, parameter.usual[1] * 10**DECADES, SIZES)
    sizes = np.r_[sizes, -sizes]
    gains = np.array([_gain(seen, size) for size in sizes])
    best = int(np.argmax(gains))
    if gains[best] <= 0:
        return None
    theta = candidate.allowed(sizes[best : best + 1])
    return Score(
        candidate,
        dict(candidate.grid[0]),
        theta,
        float(gains[best]),
        1.0,
        1,
        1.0,
        1.0,
        np.zeros(1),
        candidate.numbers({}, theta),
    )


def _gain(seen: Projection, size: float) -> float:
    """Twice the logarithm by which an effect of a size is likelier than none, its temperature's errors normal, of one
    standard deviation each.
    seen : Projection of (1 + q) columns, the effect under the temperature as it is taken to be, and under each of its
        errors."""
    b, G = seen.right, seen.gram
    left = size * (b[1:] - G[1:, 0] * size)
    scaled = np.eye(len(left)) + size**2 * G[1:, 1:]
    return float(
        2 * size * b[0] - size**2 * G[0, 0] + left @ np.linalg.solve(scaled, left) - np.linalg.slogdet(scaled)[1]
    )


def _cosine(problem: PlatformProblem, model: LinearisedModel, own: PlatformScore, other: PlatformScore) -> float:
    """Between what a finding and an effect of a temperature as logged do, nuisances taken out."""
    return column_cosine(model.linear, problem.column(model, own), problem.column(model, other))


LASTING = ("image position", "place on the marker")  # what is left and depends on these is the same in every frame
LASTING_VIEWS = ("map", "outward", "markers", "targets")  # effects that residuals show so are, too
REASON_TOGETHER = "the tolerances of printed markers, corner finder and thermometers"


def separate_findings_within_tolerances(
    problem: PlatformProblem, selection: PlatformSelection, unexplained: list[LackOfFit]
) -> tuple[PlatformSelection, list[LackOfFit], Tolerable]:
    """Separate findings that tolerances may cause, as Remarks, from the rest and the unexplained beyond them."""
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
    score, sensitivities = finding.score, problem.sensitivities.at(model.point)
    share = share_not_explained_by_tolerances(
        model, found, candidate_column(model, score.candidate, score.node, sensitivities), not len(score.coefficients)
    )
    if is_significant_alone_or_with_other_axes(problem, fit, finding.number, _weaken_score(score, share)):
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
    square = model.linear.project(residual_change_column_with_only_effects(model, others)).gram[0, 0]
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
            parameter_errors_per_tolerance_deviation(refinement, sensitivities),
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


def parameter_errors_per_tolerance_deviation(refinement: Refinement, sensitivities: Sensitivities) -> Floats | None:
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


def _moved(model: LinearisedModel, off: OperatingPoint) -> Column:
    """Column (1) of what another OperatingPoint does to corners and closures."""
    k = model.point
    out = Column((None, model.nothing(1)))
    if k.seen is not None:
        out = out + Column(model.fold((off.pixels() - k.pixels())[..., None]).parts)
    return out + model.lengthened((off.effective() - k.effective())[..., None]) if k.axes else out
