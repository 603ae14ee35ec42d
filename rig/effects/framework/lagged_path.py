"""Path that axes follow with a first-order lag behind their commands."""

from dataclasses import replace

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.effects.framework.machine_motion_and_play import STEADY, Path, first_order_lag

AFTER = np.array([0.25, 0.5, 1, 2, 4, 8])  # time constants after a change of speed at which the path gets a knot


def lagged_lengths(path: Path, time_constant: float) -> Floats:
    """Lengths (m, axes) m or rad at a path's knots, lagged by a time constant (s)."""
    return path.walked(lambda t, lengths: first_order_lag(t, lengths, time_constant))


def lagged_path(path: Path, time_constant: float, own: Booleans) -> Path:
    """Path of which some axes lag by a time constant (s), with knots where a change of their speed still shows.

    own : (axes,) whether an axis lags
    """
    turned = np.abs(np.diff(path.speeds[:, own], axis=0)).max(axis=1) > STEADY * np.abs(path.speeds).max()
    path = path.with_knots((path.t[:-1][turned, None] + AFTER * time_constant).ravel())
    return replace(path, lengths=np.where(own, lagged_lengths(path, time_constant), path.lengths))
