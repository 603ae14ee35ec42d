"""What a platform's remainder goes with: every channel of its log, known or not, time, order, step, direction, speed
and dwell.
"""

import numpy as np

from calib.diagnosis.engine.lack_of_fit import Covariate, Share, explained_share, rank_covariates
from calib.diagnosis.problems.platform.candidate_search import axis_products, corner_products
from calib.diagnosis.problems.platform.linearised_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.smooth_functions import view_pixels
from calib.diagnosis.problems.remainder_covariates import motion_functions, separate_weights, time_and_sensor_functions
from rig.compute.parallel_map import parallel_map
from rig.effects.framework.place import Place

STRUTS, IMAGES = "struts", "images"


def ranked_covariates(before: LinearisedModel, after: LinearisedModel) -> list[Covariate]:
    """[Covariate] ranked by the share of residuals they explain, without effects and with them."""
    return rank_covariates(*parallel_map(_shares, [before, after], items_per_process=1))


def _shares(model: LinearisedModel) -> dict[str, dict[str, Share]]:
    k = model.point
    out: dict[str, dict[str, Share]] = {}
    if k.axes:
        products = axis_products(model)
        for name, functions in {
            **time_and_sensor_functions(k.t, k.sensors),
            **motion_functions(k.motion(()).path, k.commanded, k.t),
        }.items():
            out.setdefault(name, {})[STRUTS] = explained_share(
                model.linear, CLOSURES, [(products, separate_weights(functions, k.axes))]
            )
    if k.seen is not None and len(k.moving) < len(k.design.cameras):
        seen = np.unique(k.seen.observations.camera)
        views = [
            corner_products(model, view_pixels(model, Place("camera", k.design.cameras[i].name)))
            for i in seen
            if i not in k.moving
        ]
        for name, functions in time_and_sensor_functions(k.t, k.sensors).items():
            parts = [(products, separate_weights(functions, products.beta.shape[1])) for products in views]
            out.setdefault(name, {})[IMAGES] = explained_share(model.linear, CORNERS, parts)
    return out
