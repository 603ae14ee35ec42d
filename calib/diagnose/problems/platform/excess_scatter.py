"""A platform's scatter beyond its noise: struts against what the measured poses' noise allows, corners against what is
stated of them.
"""

import numpy as np

from calib.diagnose.engine.excess_scatter import detect_excess_scatter
from calib.diagnose.engine.lack_of_fit import LackOfFit
from calib.diagnose.problems.platform.lack_of_fit import within
from calib.diagnose.problems.platform.linearised_residuals import LinearisedModel
from calib.models.platform.identification import parameters

MIDDLE = 5.6 / 2  # a middle square has so many times the variance of a mean square over as many numbers


def scatter_beyond_noise(model: LinearisedModel, left: list[LackOfFit]) -> list[LackOfFit]:
    """[LackOfFit] of struts and corners that scatter beyond the noise, of places at which nothing else is left and no
    admitted effect sits: what a name leaves at its own place in few frames is the name's. left : what functions
    explain"""
    known = {u.place for u in left}
    found = [*(_struts(model) if model.point.axes else []), _corners(model)]
    return [
        u
        for u in found
        if u is not None and u.place not in known and not any(within(u, effect.place) for effect in model.point.effects)
    ]


def _struts(model: LinearisedModel) -> list[LackOfFit | None]:
    """Of each strut, by its closures."""
    k, F = model.point, model.frames
    inverse = np.linalg.inv(model.closures.W)
    residual = (inverse @ model.closure_residual[: F * k.axes].reshape(F, k.axes, 1))[..., 0]
    own = model.strut_noise() - model.closures.scatter**2
    squares, freedom = (residual**2 / own).sum(axis=0), F - len(parameters(k.platform)) / k.axes
    noise = np.sqrt(own.mean(axis=0))
    return [
        detect_excess_scatter(f"strut {i + 1}", "m", float(noise[i]), float(squares[i]), freedom, k.axes)
        for i in range(k.axes)
    ]


def _corners(model: LinearisedModel) -> LackOfFit | None:
    """Of all corners, by the middle of their residuals, where somebody states their noise."""
    seen, stated = model.point.seen, None if model.point.seen is None else model.point.seen.stated
    if seen is None or stated is None:
        return None
    freedom = (len(model.corner_residual) - model.corners.local.shape[1] * model.frames) / MIDDLE
    return detect_excess_scatter("cameras", "px", stated, freedom * (model.corner_noise() / stated) ** 2, freedom)
