"""Temperature effects as alternatives of a platform's findings, where a temperature log is missing or wrong."""

import inspect
from dataclasses import replace

import numpy as np

from calib.diagnosis.engine.candidate_score import Alternative, Score
from calib.diagnosis.engine.finding_confirmation_against_alternatives import Finding, is_finding_significant
from calib.diagnosis.engine.linear_model import Column, Projection, column_cosine, join_columns
from calib.diagnosis.problems.platform.effect_candidates import (
    PlatformCandidate,
    PlatformScore,
    effect_context,
    lacks_temperature_log,
    platform_candidate,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_residuals import LinearisedModel
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem, PlatformSelection
from calib.diagnosis.problems.platform.smooth_strut_camera_and_marker_functions import SLOW
from calib.diagnosis.problems.remainder_covariates_temperatures_and_repeats import time_cosines
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect import REFERENCE_TEMPERATURE, Effect
from rig.effects.framework.effect import Candidate as EffectCandidate
from rig.model.places_and_tolerances import AXES, Place
from rig.recording.recording_folder import Sensors

WARM = tuple(
    kind
    for kind in ALL  # those that follow a temperature
    if inspect.getattr_static(kind, "follows") is not inspect.getattr_static(Effect, "follows")
)
STEP = 1e-5  # 1/K
SIZES = 200  # of a coefficient that are tried, over DECADES about what rigs show
DECADES = 1.0  # beyond


def add_temperature_alternatives(problem: PlatformProblem, selection: PlatformSelection) -> PlatformSelection:
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
        asked = [
            (kind, place)
            for kind in kinds
            for place in _places(kind, f.score.candidate.place)
            if lacks_temperature_log(k, kind.follows(place, effect_context(k)))
        ]
        findings.append(_beside_temperatures(problem, selection, f, asked) if asked else f)
    return replace(selection, findings=findings)


def _beside_temperatures(
    problem: PlatformProblem,
    selection: PlatformSelection,
    finding: Finding[PlatformCandidate],
    asked: list[tuple[type[Effect], str]],
) -> Finding[PlatformCandidate]:
    model, alternatives = problem.beside(selection.fit, finding.number), list(finding.alternatives)
    alone = problem.marginalised(model)
    own = finding.score.delta_chi2 * finding.score.dispersion
    for kind, place in asked:
        warm = problem.marginalised(model.marginalise(_courses(model, kind, place)))
        if is_finding_significant(problem, finding, warm, selection.fit, selection.asked):
            continue
        delta = alone.linear.cost() - warm.linear.cost()
        score = Score(
            platform_candidate(EffectCandidate(kind, place, [{}], [])),
            {},
            np.zeros(0),
            delta,
            1.0,
            SLOW,
            1.0,
            1.0,
            np.zeros(1),
        )
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
        asked = [c for c in warm if c.place in _places(c.kind, own.place) and (c.name, c.place) not in listed]
        if asked:
            model = problem.without_term(selection.fit, f.number)
            found = [
                (s, f.score.evidence(model.size) - s.evidence(model.size))
                for c in asked
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
