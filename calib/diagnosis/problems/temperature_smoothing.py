"""Smoothing of logged temperatures, which hold a thermometer's noise.

Noise in what an effect follows makes the effect look smaller, and leaves behind what no model explains (Fuller,
Measurement error models, 1987, ch. 1).
"""

from dataclasses import replace

import numpy as np
import scipy

from rig.array_and_json_types import Floats
from rig.recording.recording_folder import Sensors

DEGREES = (
    1,
    2,
)  # of the plainest courses: a temperature has at least a slope, and a log too short to show it still bounds it
KNOTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)  # stretches of a cubic spline that are tried beyond these
ROWS = 4  # of the log for each stretch, and beyond what a course takes, at least
ALIKE = 3.0  # standard errors by which what is taken for noise may follow its neighbour
FAR = 8.0  # times its middle size that noise may reach


def smooth_temperatures(sensors: Sensors | None) -> tuple[Sensors | None, dict[str, Floats]]:
    """(Sensors with smoothed temperatures, {channel: (n, q) K error of each smoothing coefficient}).

    A log that is not smooth with white noise on it stays as it is, and so do all other channels. sensors : Sensors or
    None, for which (None, {}) is returned. Source of the criterion: Schwarz, Annals of Statistics 6, 1978, 461-464; for
    few rows McQuarrie, Statistics and Probability Letters 44, 1999, 79-86
    """
    if sensors is None:
        return None, {}
    edges = [
        0,
        *np.searchsorted(sensors.t, sensors.starts).tolist(),
        len(sensors.t),
    ]  # of the logs, each of one recording
    parts = [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]
    tried = {
        name: [_smooth(sensors.t[part], values[part]) for part in parts]
        for name, values in sensors.channels.items()
        if name.endswith("temperature_C")
    }
    courses = {
        name: _joined(sensors.channels[name], parts, found)
        for name, found in tried.items()
        if any(one is not None for one in found)
    }
    channels = {**sensors.channels, **{name: curve for name, (curve, _) in courses.items()}}
    return replace(sensors, channels=channels), {name: errors for name, (_, errors) in courses.items()}


def _joined(values: Floats, parts: list[slice], found: list[tuple[Floats, Floats] | None]) -> tuple[Floats, Floats]:
    """(curve (n,), errors (n, q)) of a log (n,) in parts, each by itself; a part that is not smoothed stands as it
    is.
    """
    curve, errors = values.astype(float), []
    for part, one in zip(parts, found):
        if one is not None:
            curve[part] = one[0]
            own = np.zeros((len(values), one[1].shape[1]))
            own[part] = one[1]
            errors.append(own)
    return curve, np.concatenate(errors, axis=1)


def _smooth(t: Floats, values: Floats) -> tuple[Floats, Floats] | None:
    """(curve (n,), errors (n, q)) of a log (n,), or None where there is no saying what of it is noise."""
    courses = _courses(t)
    if len(courses) < 2 or (np.diff(t) <= 0).any() or np.ptp(values) == 0:
        return None
    tried = []
    for Q in courses:
        noise = values - Q @ (Q.T @ values)
        tried.append((len(t) * np.log(np.mean(noise**2) + 1e-300) + _price(len(t), Q.shape[1]), noise))
    best = min(range(len(tried)), key=lambda i: tried[i][0])
    noise, Q = tried[best][1], courses[best]
    follows = abs(noise[1:] @ noise[:-1]) > ALIKE / np.sqrt(len(t)) * (noise @ noise)
    wild = np.abs(noise).max() > FAR * np.median(np.abs(noise))
    if follows or wild or best == len(courses) - 1:
        return None
    return values - noise, courses[best + 1] * np.sqrt(noise @ noise / (len(t) - Q.shape[1]))


def _price(rows: int, numbers: int) -> float:
    """Of a course's numbers, as minus twice a logarithm: Schwarz's, corrected for few rows."""
    return rows * np.log(rows) * numbers / (rows - numbers - 2)


def _courses(t: Floats) -> list[Floats]:
    """Orthonormal bases (n, q) of the courses that a log at times (n,) s bears, the plainest first."""
    plain = [
        np.vander((t - t[0]) / max(np.ptp(t), 1e-300), degree + 1) for degree in DEGREES if degree + 1 + ROWS <= len(t)
    ]
    splines = []
    for count in (count for count in KNOTS if count * ROWS + ROWS <= len(t)):
        inner = np.interp(np.linspace(0, len(t) - 1, count + 1)[1:-1], np.arange(len(t)), t)
        splines.append(scipy.interpolate.BSpline.design_matrix(t, np.r_[[t[0]] * 4, inner, [t[-1]] * 4], 3).toarray())
    return [np.linalg.qr(basis)[0] for basis in plain + splines]
