"""What thermometers and tolerances leave open of effects that a fit took to be free of them: by how much intervals are
wider for it.
"""

from dataclasses import replace

import numpy as np

from calib.diagnosis.engine.linear_model import Column, Projection, join_columns
from calib.diagnosis.problems.platform.effect_candidates import effect_context
from calib.diagnosis.problems.platform.effect_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.linearised_residuals import LinearisedModel
from calib.diagnosis.problems.platform.operating_point import OperatingPoint
from calib.diagnosis.problems.platform.simultaneous_refinement import Refined
from calib.diagnosis.problems.platform.temperature_alternatives import WARM
from calib.diagnosis.problems.platform.tolerance_columns import TOGETHER, ToleranceModel, tolerance_model
from rig.arrays import Floats

MOST = 2.0  # of what is tolerated, that a kind of it is taken to vary by
ROUNDS, SETTLED = 100, 1e-3  # of the fixed point; the part of what is tolerated by which it may still change


def widen_intervals(refined: Refined, sensitivities: Sensitivities) -> Refined:
    """Refined with intervals (its covariance) widened by temperature log errors and tolerances."""
    added = [
        half for half in (temperature_log_errors(refined), tolerance_errors(refined, sensitivities)) if half is not None
    ]
    return replace(refined, covariance=refined.covariance + sum(half @ half.T for half in added))


def temperature_log_errors(refined: Refined) -> Floats | None:
    """(c, k) errors of the coordinates per standard deviation of temperature log errors, or None."""
    k, sensors, parts = refined.point, refined.point.sensors, []
    if sensors is None or refined.column is None:
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
            parts += [_moved(refined.model, replace(k, sensors=replace(sensors, channels=course)))]
    if not parts:
        return None
    own = len(refined.coordinates)
    both = join_columns([Column(refined.column.parts), *parts])
    return refined.covariance @ refined.model.linear.project(both).gram[:own, own:]


def tolerance_errors(refined: Refined, sensitivities: Sensitivities) -> Floats | None:
    """(c, q) errors of the coordinates per standard deviation of what tolerances do, or None.
    What an effect is the size of is nothing that it
    is off by.
    """
    found = tolerance_model(refined.marginalised, sensitivities)
    if found is None or refined.column is None:
        return None
    linear = refined.model.linear
    across = (
        found.with_column(refined.column) - linear.project(refined.column).onto.T @ found.projected(refined.model).onto
    )
    off = refined.covariance @ across * observed_tolerance_sigmas(found.projected(refined.marginalised), found)
    for i, c in enumerate(refined.coordinates):
        effect = refined.point.effects[c.effect]
        for site in found.sites:
            if (site.effect, site.place) == (effect.name, effect.place):
                off[i, site.columns] = 0.0
    return off


def observed_tolerance_sigmas(seen: Projection, found: ToleranceModel) -> Floats:
    """(q,) standard deviations of what tolerances do, of each kind as the residuals show it, at the most MOST

    Source: MacKay, Bayesian interpolation, Neural Computation 4, 1992, sec. 4
    """
    share = np.ones(found.kinds.max() + 1)
    for _ in range(ROUNDS):
        sigma = found.sigma * share[found.kinds]
        on = np.flatnonzero(sigma)
        width = sigma[on]
        inverse = np.linalg.inv(np.eye(len(on)) + width[:, None] * seen.gram[np.ix_(on, on)] * width)
        sizes, known = share[found.kinds[on]] * (inverse @ (width * seen.right[on])), 1 - np.diag(inverse)
        new = share.copy()
        for kind in np.unique(found.kinds[on]):
            own = found.kinds[on] == kind
            if kind != TOGETHER:
                new[kind] = min(np.sqrt((sizes[own] ** 2).sum() / max(known[own].sum(), 1e-9)), MOST)
        new[new < SETTLED] = 0.0
        if np.abs(new - share).max() < SETTLED:
            break
        share = new
    return found.sigma * share[found.kinds]


def _moved(model: LinearisedModel, off: OperatingPoint) -> Column:
    """Column (1) of what another OperatingPoint does to corners and closures."""
    k = model.point
    out = Column((None, model.nothing(1)))
    if k.seen is not None:
        out = out + Column(model.fold((off.pixels() - k.pixels())[..., None]).parts)
    return out + model.lengthened((off.effective() - k.effective())[..., None]) if k.axes else out
