"""Temperatures as they were, from a log that holds a thermometer's noise as well: noise in what an effect follows makes the effect look smaller,
and leaves behind what no model explains."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_lsq_spline

KNOTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)  # stretches of a spline that are tried
ROWS = 4  # of the log for each stretch, at least
ALIKE = 3.0  # standard errors by which what is taken for noise may follow its neighbour
FAR = 8.0  # times its middle size that noise may reach


def smoothed(sensors):
    """Sensors with each temperature's cubic spline (as many stretches as Schwarz's criterion grants) in place of its log; a log that is not
    smooth with white noise on it stays as it is, and so do all other channels. sensors : Sensors or None"""
    if sensors is None:
        return None
    names = [name for name in sensors.channels if name.endswith("temperature_C")]
    return replace(sensors, channels={**sensors.channels, **{name: _smooth(sensors.t, sensors.channels[name]) for name in names}})


def _smooth(t, values):
    counts = [count for count in KNOTS if count * ROWS + ROWS <= len(t)]
    if len(counts) < 2 or (np.diff(t) <= 0).any() or np.ptp(values) == 0:
        return values
    best = None
    for count in counts:
        inner = np.interp(np.linspace(0, len(t) - 1, count + 1)[1:-1], np.arange(len(t)), t)
        curve = make_lsq_spline(t, values, np.r_[[t[0]] * 4, inner, [t[-1]] * 4])(t)
        criterion = len(t) * np.log(np.mean((values - curve) ** 2) + 1e-300) + (count + 3) * np.log(len(t))
        if best is None or criterion < best[0]:
            best = criterion, count, curve
    noise = values - best[2]
    follows = abs(noise[1:] @ noise[:-1]) > ALIKE / np.sqrt(len(t)) * (noise @ noise)
    wild = np.abs(noise).max() > FAR * np.median(np.abs(noise))
    return values if follows or wild or best[1] == counts[-1] else best[2]
