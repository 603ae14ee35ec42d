"""What a platform's remainder goes with: every channel of its log, known or not, time, order, step, direction, speed and dwell."""

import numpy as np

from calib.diagnose.engine.ranking import Covariate, Share, ranked, share
from calib.diagnose.problems.platform.linearised import CLOSURES, CORNERS, LinearisedModel
from calib.diagnose.problems.platform.operating_point import OperatingPoint
from calib.diagnose.problems.platform.search import axis_products, corner_products
from calib.diagnose.problems.platform.smooth import cosines, direction, powers, speed, view_pixels

COURSE = 4  # cosines of a covariate that goes on and on
STRUTS, IMAGES = "struts", "images"
AT_ONCE = 1e-3  # s; a shorter wait counts as so long


def covariates(before: LinearisedModel, after: LinearisedModel) -> list[Covariate]:
    """[Covariate] of what is left with nothing admitted and with all, the one that explained most before first."""
    return ranked(_shares(before), _shares(after))


def _shares(model: LinearisedModel) -> dict[str, dict[str, Share]]:
    k = model.point
    out: dict[str, dict[str, Share]] = {}
    if k.axes:
        products = axis_products(model)
        for name, functions in {**_frames(k), **_moves(k)}.items():
            out.setdefault(name, {})[STRUTS] = share(model.linear, CLOSURES, [(products, _strutwise(functions, k.axes))])
    if k.seen is not None and len(k.moving) < len(k.design.cameras):
        seen = np.unique(k.seen.observations.camera)
        views = [corner_products(model, view_pixels(model, f"camera {k.design.cameras[i].name}")) for i in seen if i not in k.moving]
        for name, functions in _frames(k).items():
            parts = [(products, _strutwise(functions, products.beta.shape[1])) for products in views]
            out.setdefault(name, {})[IMAGES] = share(model.linear, CORNERS, parts)
    return out


def _frames(k: OperatingPoint) -> dict[str, np.ndarray]:
    """{covariate: (F, 1, q) functions of it} that are the same for all struts and cameras."""
    order = np.argsort(np.argsort(k.t)).astype(float)
    out = {"time": cosines(k.t, COURSE), "order": cosines(order, COURSE)}
    if k.sensors is not None:
        logged = {name: np.interp(k.t, k.sensors.t, values) for name, values in k.sensors.channels.items()}
        out |= {name: powers(series, 2) for name, series in logged.items() if np.ptp(series) > 0}
    return {name: functions[:, None, :] for name, functions in out.items()}


def _moves(k: OperatingPoint) -> dict[str, np.ndarray]:
    """{covariate: (F, axes or 1, q) functions of it} of how the struts came to where they were."""
    path = k.motion(()).path
    wait = np.log(np.maximum(path.dwell, AT_ONCE))
    own = {"step": path.last_step, "speed": speed(k), "way travelled": path.way}
    out = {name: np.stack([powers(column, 2) for column in values.T], axis=1) for name, values in own.items() if np.ptp(values) > 0}
    out["direction"] = direction(path)[..., None]
    return {**out, "dwell": powers(wait, 2)[:, None, :]} if np.ptp(wait) > 0 else out


def _strutwise(functions: np.ndarray, count: int) -> np.ndarray:
    """(F, count, count q) weights: functions (F, count or 1, q) at each of so many directions, each of its own size."""
    wide = np.broadcast_to(functions, (len(functions), count, functions.shape[2]))
    return np.einsum("faq,ab->fabq", wide, np.eye(count)).reshape(len(functions), count, -1)
