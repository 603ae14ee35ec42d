"""A platform's scatter beyond its noise: struts against what the measured poses' noise allows, corners against what is
stated of them.
"""

from typing import cast

import numpy as np

from calib.diagnosis.engine.lack_of_fit import LackOfFit, detect_excess_scatter
from calib.diagnosis.problems.platform.lack_of_fit import is_at_place
from calib.diagnosis.problems.platform.linearised_residuals import LinearisedModel
from calib.models.platform.identification import geometric_parameters
from rig.arrays import Floats
from rig.effects.framework.place import Place

MIDDLE = 5.6 / 2  # a middle square has so many times the variance of a mean square over as many numbers


def excess_scatter(model: LinearisedModel, left: list[LackOfFit]) -> list[LackOfFit]:
    """[LackOfFit] of excess scatter of struts and corners, at places with no other lack of fit.
    left : what functions
    explain
    """
    known = {u.place for u in left}
    found = [*(_strut_scatter(model) if model.point.axes else []), _corners(model)]
    return [
        u
        for u in found
        if u is not None
        and u.place not in known
        and not any(is_at_place(u, effect.place) for effect in model.point.effects)
    ]


def closure_residuals(model: LinearisedModel) -> Floats:
    """(F, axes) m that a model as it is leaves of the closures."""
    return closures_in_metres(model, model.closure_residual)


def closures_in_metres(model: LinearisedModel, closures: Floats) -> Floats:
    """(F, axes) m of whitened closures (F axes + .,)."""
    F, axes = model.frames, model.point.axes
    return (
        cast(Floats, np.linalg.solve(model.closures.W, closures[: F * axes].reshape(F, axes, 1))[..., 0])
        if axes
        else np.zeros((F, 0))
    )


def _strut_scatter(model: LinearisedModel) -> list[LackOfFit | None]:
    """Of each strut, by its closures."""
    k, F = model.point, model.frames
    inverse = np.linalg.inv(model.closures.W)
    residual = (inverse @ model.closure_residual[: F * k.axes].reshape(F, k.axes, 1))[..., 0]
    own = model.strut_noise() - model.closures.scatter**2
    squares, freedom = (residual**2 / own).sum(axis=0), F - len(geometric_parameters(k.platform)) / k.axes
    noise = np.sqrt(own.mean(axis=0))
    return [
        detect_excess_scatter(str(Place.axis("strut", i)), "m", float(noise[i]), float(squares[i]), freedom, k.axes)
        for i in range(k.axes)
    ]


def _corners(model: LinearisedModel) -> LackOfFit | None:
    """Of all corners, by the middle of their residuals, where somebody states their noise."""
    seen, stated = model.point.seen, None if model.point.seen is None else model.point.seen.stated
    if seen is None or stated is None:
        return None
    freedom = (len(model.corner_residual) - model.corners.local.shape[1] * model.frames) / MIDDLE
    return detect_excess_scatter("cameras", "px", stated, freedom * (model.corner_noise() / stated) ** 2, freedom)
