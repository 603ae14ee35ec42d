"""Covariates of a machine's remainder as functions: log channels, time, order, step, direction, speed,
dwell, way travelled.
"""

import numpy as np

from rig.array_types import Floats
from rig.effects.framework.machine_motion_and_play import Path
from rig.model.motion_simulation import ABOUT
from rig.recording.recording_folder import Commands, Sensors

COURSE = 4  # cosines of a covariate that goes on and on
AT_ONCE = 1e-3  # s; a shorter wait counts as so long


def time_and_sensor_functions(t: Floats, sensors: Sensors | None) -> dict[str, Floats]:
    """{covariate: (F, 1, q) functions} of time and of each sensor, at times (F,) s, alike for all axes and cameras."""
    order = np.argsort(np.argsort(t)).astype(float)
    out = {"time": time_cosines(t, COURSE), "order": time_cosines(order, COURSE)}
    if sensors is not None:
        logged = {name: np.interp(t, sensors.t, values) for name, values in sensors.channels.items()}
        out |= {name: scaled_powers(series, 2) for name, series in logged.items() if np.ptp(series) > 0}
    return {name: functions[:, None, :] for name, functions in out.items()}


def motion_functions(path: Path, commands: Commands, t: Floats) -> dict[str, Floats]:
    """{covariate: (F, axes or 1, q) functions} of the axes' motion up to times (F,) s."""
    wait = np.log(np.maximum(path.dwell, AT_ONCE))
    own = {"step": path.last_step, "speed": axis_speeds(commands, t), "way travelled": path.way}
    out = {
        name: np.stack([scaled_powers(column, 2) for column in values.T], axis=1)
        for name, values in own.items()
        if np.ptp(values) > 0
    }
    out["direction"] = path.direction[..., None]
    return {**out, "dwell": scaled_powers(wait, 2)[:, None, :]} if np.ptp(wait) > 0 else out


def separate_weights(functions: Floats, count: int) -> Floats:
    """(F, count, count q) weights separate for each direction, made of functions (F, count or 1, q)."""
    wide = np.broadcast_to(functions, (len(functions), count, functions.shape[2]))
    return np.einsum("faq,ab->fabq", wide, np.eye(count)).reshape(len(functions), count, -1)


def scaled_to_plus_minus_one(x: Floats) -> Floats:
    """x (F,) about its mean, scaled to within plus or minus one."""
    return (x - x.mean()) / max(np.abs(x - x.mean()).max(), 1e-300)


def scaled_powers(x: Floats, highest: int) -> Floats:
    """(F, highest) powers, from the first on, of a covariate x (F,), scaled to within -1 .. 1."""
    return np.stack([scaled_to_plus_minus_one(x) ** n for n in range(1, highest + 1)], axis=1)


def time_cosines(t: Floats, count: int) -> Floats:
    """(F, count) cosines of time, slowest first."""
    s = (t - t[0]) / max(np.ptp(t), 1e-300)
    return np.cos(np.pi * s[:, None] * np.arange(1, count + 1))


def axis_speeds(commands: Commands, t: Floats) -> Floats:
    """(F, axes) m/s or rad/s, speeds of the commanded axes at times (F,) s."""
    ends = [
        np.stack([np.interp(t + s * ABOUT, commands.t, column) for column in commands.values.T], axis=1)
        for s in (1, -1)
    ]
    return (ends[0] - ends[1]) / (2 * ABOUT)
