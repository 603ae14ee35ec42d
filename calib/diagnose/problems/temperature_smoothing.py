"""Temperatures as they were, from a log that holds a thermometer's noise as well: noise in what an effect follows makes the effect look smaller,
and leaves behind what no model explains (Fuller, Measurement error models, 1987, ch. 1)."""

from dataclasses import replace

import numpy as np
import scipy

from rig.recording import Sensors

KNOTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)  # stretches of a spline that are tried
ROWS = 4  # of the log for each stretch, at least
ALIKE = 3.0  # standard errors by which what is taken for noise may follow its neighbour
FAR = 8.0  # times its middle size that noise may reach


def smoothed(sensors: Sensors | None) -> tuple[Sensors | None, dict[str, np.ndarray]]:
    """(Sensors, {channel: (n, q) K}): each temperature's cubic spline, of as many stretches as Schwarz's criterion grants, in place of its log, and
    the spline's own errors as q directions of one standard deviation each.

    A log that is not smooth with white noise on it stays as it is, and so do all other channels. sensors : Sensors or None, for which (None, {})
    is returned. Source of the criterion: Schwarz, Annals of Statistics 6, 1978, 461-464
    """
    if sensors is None:
        return None, {}
    edges = [0, *np.searchsorted(sensors.t, sensors.starts).tolist(), len(sensors.t)]  # of the logs, each of one recording
    parts = [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]
    tried = {name: [_smooth(sensors.t[part], values[part]) for part in parts] for name, values in sensors.channels.items()
             if name.endswith("temperature_C")}
    courses = {name: _joined(sensors.channels[name], parts, found) for name, found in tried.items() if any(one is not None for one in found)}
    channels = {**sensors.channels, **{name: curve for name, (curve, _) in courses.items()}}
    return replace(sensors, channels=channels), {name: errors for name, (_, errors) in courses.items()}


def _joined(values: np.ndarray, parts: list[slice], found: list[tuple[np.ndarray, np.ndarray] | None]) -> tuple[np.ndarray, np.ndarray]:
    """(curve (n,), errors (n, q)) of a log (n,) in parts, each by itself; a part that is not smoothed stands as it is."""
    curve, errors = values.astype(float), []
    for part, one in zip(parts, found):
        if one is not None:
            curve[part] = one[0]
            own = np.zeros((len(values), one[1].shape[1]))
            own[part] = one[1]
            errors.append(own)
    return curve, np.concatenate(errors, axis=1)


def _smooth(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """(curve (n,), errors (n, q)) of a log (n,), or None where there is no saying what of it is noise."""
    counts = [count for count in KNOTS if count * ROWS + ROWS <= len(t)]
    if len(counts) < 2 or (np.diff(t) <= 0).any() or np.ptp(values) == 0:
        return None
    best: tuple[float, int, np.ndarray, np.ndarray] | None = None
    for count in counts:
        inner = np.interp(np.linspace(0, len(t) - 1, count + 1)[1:-1], np.arange(len(t)), t)
        basis = scipy.interpolate.BSpline.design_matrix(t, np.r_[[t[0]] * 4, inner, [t[-1]] * 4], 3).toarray()
        Q = np.linalg.qr(basis)[0]
        noise = values - Q @ (Q.T @ values)
        criterion = len(t) * np.log(np.mean(noise**2) + 1e-300) + Q.shape[1] * np.log(len(t))
        if best is None or criterion < best[0]:
            best = criterion, count, noise, Q
    if best is None:
        return None
    _, count, noise, Q = best
    follows = abs(noise[1:] @ noise[:-1]) > ALIKE / np.sqrt(len(t)) * (noise @ noise)
    wild = np.abs(noise).max() > FAR * np.median(np.abs(noise))
    if follows or wild or count == counts[-1]:
        return None
    return values - noise, Q * np.sqrt(noise @ noise / (len(t) - Q.shape[1]))
