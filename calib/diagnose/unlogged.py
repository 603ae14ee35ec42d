"""Effects that follow a temperature which nobody logged: rivals of whatever a smooth course of it would explain as well."""

from dataclasses import replace

import numpy as np

from calib.diagnose.hypotheses import Family
from calib.diagnose.planes import Column
from calib.diagnose.scan import Rival, Score
from calib.diagnose.select import beside, freed, stands
from calib.diagnose.settle import joined
from calib.diagnose.smooth import SLOW, cosines
from rig.effects.base import REFERENCE_TEMPERATURE
from rig.effects.base_expansion import BaseExpansion
from rig.effects.focal_drift import FocalDrift
from rig.effects.thermal_expansion import ThermalExpansion
from rig.recording import Sensors

WARM = (ThermalExpansion, BaseExpansion, FocalDrift)
STEP = 1e-5  # 1/K


def unlogged(selection, signatures):
    """Selection in which every finding that could as well be an effect of a temperature, had it run as some smooth function of time, has that
    effect among its rivals; effects whose temperature was logged are not asked for."""
    settled = selection.settled
    k = settled.knowledge
    kinds = [kind for kind in WARM if not _logged(k, kind) and (k.axes if kind.stage != "view" else k.seen is not None)]
    if not kinds or not selection.findings:
        return selection
    findings = []
    for f in selection.findings:
        planes, rivals = beside(settled, f.number, signatures), list(f.rivals)
        alone = freed(planes, signatures)
        own = f.score.drop * f.score.dispersion
        for kind in kinds:
            column = _courses(planes, kind)
            warm = freed(planes.without(column), signatures)
            if stands(f, warm, selection.families, signatures):
                continue
            drop = alone.cost() - warm.cost()
            score = Score(Family(kind, _place(kind), [{}], []), {}, np.zeros(0), drop, 1.0, SLOW, 1.0, 1.0, np.zeros(1))
            behind = own - drop - (f.score.freedom - SLOW) * np.log(planes.size)
            rivals.append(Rival(score, behind, float(np.sqrt(np.clip(drop / own, 0, 1)))))
        findings.append(replace(f, rivals=rivals))
    return replace(selection, findings=findings)


def _logged(k, kind):
    channels = k.sensors.channels if k.sensors is not None else {}
    if kind is ThermalExpansion:
        return any(name.startswith("strut") and name.endswith("_temperature_C") for name in channels)
    return "ambient_temperature_C" in channels or kind is FocalDrift and any(name.startswith("camera_") for name in channels)


def _place(kind):
    return "rig" if "rig" in kind.places else kind.places[0]


def _courses(planes, kind):
    """Column (SLOW) of an effect under temperatures that are cosines of time."""
    k, parts = planes.knowledge, []
    place = _place(kind)
    channels = ["ambient_temperature_C", *(f"strut{i + 1}_temperature_C" for i in range(k.axes))]
    order = np.argsort(k.t)
    for course in cosines(k.t, SLOW).T:
        known = replace(k, sensors=Sensors(k.t[order], {channel: REFERENCE_TEMPERATURE + course[order] for channel in channels}))
        effect = kind(place, **{kind.parameters[0].name: STEP})
        if kind.stage == "view":
            parts.append(planes.fold(((known.pixels((*k.effects, effect)) - known.pixels(k.effects)) / STEP)[..., None]))
        else:
            parts.append(Column(None, planes.whitened((effect.deviation(known.motion(())) / STEP)[..., None])))
    return joined(parts, len(planes.image), planes.local.shape[1], planes.frames)
