"""Effects that follow a temperature: how much less sure a thermometer's noise makes them, and where none was logged, whatever a smooth course of it
would explain as well has them for rivals."""

from dataclasses import replace

import numpy as np

from calib.diagnose.hypotheses import Family, context_of
from calib.diagnose.planes import Column
from calib.diagnose.scan import Rival, Score
from calib.diagnose.select import beside, freed, stands
from calib.diagnose.settle import joined
from calib.diagnose.smooth import SLOW, cosines
from rig.effects.base import AXES, REFERENCE_TEMPERATURE
from rig.effects.base_expansion import BaseExpansion
from rig.effects.focal_drift import FocalDrift
from rig.effects.thermal_expansion import ThermalExpansion
from rig.recording import Sensors

WARM = (ThermalExpansion, BaseExpansion, FocalDrift)
STEP = 1e-5  # 1/K


def unlogged(selection, signatures):
    """Selection in which every finding that could as well be an effect of a temperature, had it run as some smooth function of time, has that
    effect among its rivals, at its own place or at the whole machine; effects whose temperature was logged are not asked for."""
    settled = selection.settled
    k = settled.knowledge
    kinds = [kind for kind in WARM if (k.axes if kind.stage != "view" else k.seen is not None)]
    findings = []
    for f in selection.findings:
        asked = [(kind, place) for kind in kinds for place in _places(kind, f.score.family.place) if _lacking(k, kind.follows(place, context_of(k)))]
        if not asked:
            findings.append(f)
            continue
        planes, rivals = beside(settled, f.number, signatures), list(f.rivals)
        alone = freed(planes, signatures)
        own = f.score.drop * f.score.dispersion
        for kind, place in asked:
            warm = freed(planes.without(_courses(planes, kind, place)), signatures)
            if stands(f, warm, selection.families, signatures):
                continue
            drop = alone.cost() - warm.cost()
            score = Score(Family(kind, place, [{}], []), {}, np.zeros(0), drop, 1.0, SLOW, 1.0, 1.0, np.zeros(1))
            behind = own - drop - (f.score.freedom - SLOW) * np.log(planes.size)
            rivals.append(Rival(score, behind, float(np.sqrt(np.clip(drop / own, 0, 1)))))
        findings.append(replace(f, rivals=rivals))
    return replace(selection, findings=findings)


def widened(settled):
    """Settled whose covariance holds what the temperatures' own errors add, see `weather.smoothed`."""
    k, parts = settled.knowledge, []
    channels = {next(name for name in names if name in k.sensors.channels)
                for e in k.effects if type(e) in WARM for names in type(e).follows(e.place, context_of(k))}
    for channel in sorted(channels & k.log_errors.keys()):
        for error in k.log_errors[channel].T:
            course = {**k.sensors.channels, channel: k.sensors.channels[channel] + error}
            off = replace(k, sensors=replace(k.sensors, channels=course))
            image = settled.planes.fold((off.pixels() - k.pixels())[..., None]) if k.seen is not None else None
            struts = Column(None, settled.planes.whitened((off.effective() - k.effective())[..., None])) if k.axes else None
            parts.append(_both(image, struts))
    if not parts:
        return settled
    planes, own = settled.planes, len(settled.coordinates)
    both = joined([settled.column, *parts], len(planes.image), planes.local.shape[1], planes.frames)
    moved = settled.covariance @ planes.project(both)[2][:own, own:]
    return replace(settled, covariance=settled.covariance + moved @ moved.T)


def _both(a, b):
    """Column of what two Columns do together, either of them None."""
    if a is None or b is None:
        return a or b
    return Column(a.image, a.struts + b.struts, a.inner)


def _places(kind, place):
    """Where an effect may sit that looks like a finding at a place: all over, or just there."""
    at = place.split(" ")[0]
    own = at in kind.places or (at in AXES and "axis" in kind.places)
    return [whole for whole in kind.places if whole not in ("axis", "camera")] + [place] * (own and " " in place)


def _lacking(k, followed):
    logged = set(k.sensors.channels) if k.sensors is not None else set()
    return not all(logged & set(channels) for channels in followed)


def _courses(planes, kind, place):
    """Column (SLOW) of an effect under temperatures that are cosines of time."""
    k, parts = planes.knowledge, []
    order = np.argsort(k.t)
    logged = {name: k.sensors.at(k.t[order], name) for name in k.sensors.channels} if k.sensors is not None else {}
    for course in cosines(k.t, SLOW).T:
        warmth = {channels[0]: REFERENCE_TEMPERATURE + course[order] for channels in kind.follows(place, context_of(k))}
        known = replace(k, sensors=Sensors(k.t[order], {**logged, **warmth}))
        effect = kind(place, **{kind.parameters[0].name: STEP})
        if kind.stage == "view":
            parts.append(planes.fold(((known.pixels((*k.effects, effect)) - known.pixels(k.effects)) / STEP)[..., None]))
        else:
            parts.append(Column(None, planes.whitened((effect.deviation(known.motion(())) / STEP)[..., None])))
    return joined(parts, len(planes.image), planes.local.shape[1], planes.frames)
