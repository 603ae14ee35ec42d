"""Effects that follow a temperature: how much less sure a thermometer's noise makes them, and where none was logged, whatever a smooth course of it
would explain as well has them for alternatives."""

import inspect
from dataclasses import replace

import numpy as np

from calib.diagnose.engine.linear import Column, joined
from calib.diagnose.engine.score import Alternative, Score
from calib.diagnose.engine.select import Finding, stands
from calib.diagnose.problems.histories import cosines
from calib.diagnose.problems.platform.candidates import candidate_of, context_of
from calib.diagnose.problems.platform.linearised import LinearisedModel
from calib.diagnose.problems.platform.operating_point import OperatingPoint
from calib.diagnose.problems.platform.problem import PlatformProblem, PlatformSelection
from calib.diagnose.problems.platform.refine import Refined
from calib.diagnose.problems.platform.smooth import SLOW
from rig.effects import ALL
from rig.effects.base import AXES, REFERENCE_TEMPERATURE, Effect
from rig.effects.candidate import Candidate as EffectCandidate
from rig.recording import Sensors

WARM = tuple(kind for kind in ALL  # those that follow a temperature
             if inspect.getattr_static(kind, "follows") is not inspect.getattr_static(Effect, "follows"))
STEP = 1e-5  # 1/K


def unlogged(problem: PlatformProblem, selection: PlatformSelection) -> PlatformSelection:
    """Selection in which every finding that could as well be an effect of a temperature, had it run as some smooth function of time, has that
    effect among its alternatives, at its own place or at the whole machine; effects whose temperature was logged are not asked for."""
    k = selection.fit.refined.point
    kinds = [kind for kind in WARM if (k.axes if kind.stage != "view" else k.seen is not None)]
    findings = []
    for f in selection.findings:
        asked = [(kind, place) for kind in kinds for place in _places(kind, f.score.candidate.place)
                 if _lacking(k, kind.follows(place, context_of(k)))]
        findings.append(_beside_temperatures(problem, selection, f, asked) if asked else f)
    return replace(selection, findings=findings)


def _beside_temperatures(problem: PlatformProblem, selection: PlatformSelection, finding: Finding,
                         asked: list[tuple[type[Effect], str]]) -> Finding:
    model, alternatives = problem.beside(selection.fit, finding.number), list(finding.alternatives)
    alone = problem.marginalised(model)
    own = finding.score.delta_chi2 * finding.score.dispersion
    for kind, place in asked:
        warm = problem.marginalised(model.marginalise(_courses(model, kind, place)))
        if stands(problem, finding, warm, selection.fit, selection.asked):
            continue
        delta = alone.linear.cost() - warm.linear.cost()
        score = Score(candidate_of(EffectCandidate(kind, place, [{}], [])), {}, np.zeros(0), delta, 1.0, SLOW, 1.0, 1.0, np.zeros(1))
        behind = own - delta - (finding.score.freedom - SLOW) * np.log(model.size)
        alternatives.append(Alternative(score, behind, float(np.sqrt(np.clip(delta / own, 0, 1)))))
    return replace(finding, alternatives=alternatives)


def widened(refined: Refined) -> Refined:
    """Refined whose covariance holds what the temperatures' own errors add, see `temperature_smoothing.smoothed`."""
    k, sensors, parts = refined.point, refined.point.sensors, []
    if sensors is None or refined.column is None:
        return refined
    channels = {next(name for name in names if name in sensors.channels)
                for e in k.effects if type(e) in WARM for names in type(e).follows(e.place, context_of(k))}
    for channel in sorted(channels & k.log_errors.keys()):
        for error in k.log_errors[channel].T:
            course = {**sensors.channels, channel: sensors.channels[channel] + error}
            off = replace(k, sensors=replace(sensors, channels=course))
            parts += [_moved(refined.model, off)]
    if not parts:
        return refined
    own = len(refined.coordinates)
    both = joined([Column(refined.column.parts), *parts])
    added = refined.covariance @ refined.model.linear.project(both).gram[:own, own:]
    return replace(refined, covariance=refined.covariance + added @ added.T)


def _moved(model: LinearisedModel, off: OperatingPoint) -> Column:
    """Column (1) of what another OperatingPoint does to corners and closures."""
    k = model.point
    out = Column((None, model.nothing(1)))
    if k.seen is not None:
        out = out + Column(model.fold((off.pixels() - k.pixels())[..., None]).parts)
    return out + model.lengthened((off.effective() - k.effective())[..., None]) if k.axes else out


def _places(kind: type[Effect], place: str) -> list[str]:
    """Where an effect may sit that looks like a finding at a place: all over, or just there."""
    at = place.split(" ")[0]
    own = at in kind.places or (at in AXES and "axis" in kind.places)
    return [whole for whole in kind.places if whole not in ("axis", "camera")] + [place] * (own and " " in place)


def _lacking(k: OperatingPoint, followed: tuple[tuple[str, ...], ...]) -> bool:
    logged = set(k.sensors.channels) if k.sensors is not None else set()
    return not all(logged & set(channels) for channels in followed)


def _courses(model: LinearisedModel, kind: type[Effect], place: str) -> Column:
    """Column (SLOW) of an effect under temperatures that are cosines of time."""
    k, parts = model.point, []
    order = np.argsort(k.t)
    logged = {name: k.sensors.at(k.t[order], name) for name in k.sensors.channels} if k.sensors is not None else {}
    for course in cosines(k.t, SLOW).T:
        warmth = {channels[0]: REFERENCE_TEMPERATURE + course[order] for channels in kind.follows(place, context_of(k))}
        known = replace(k, sensors=Sensors(k.t[order], {**logged, **warmth}))
        effect = kind(place, **{kind.parameters[0].name: STEP})
        if kind.stage == "view":
            parts.append(model.fold(((known.pixels((*k.effects, effect)) - known.pixels(k.effects)) / STEP)[..., None]))
        else:
            parts.append(model.lengthened((effect.deviation(known.motion(())) / STEP)[..., None]))
    return joined(parts)
