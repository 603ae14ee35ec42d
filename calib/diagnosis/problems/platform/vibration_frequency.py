"""Frequency of a vibrating platform.

A coarse spectrum of all directions, then the exact score near its peak.
"""

from typing import cast

import numpy as np
import scipy
from scipy.fft import next_fast_len, rfft

from calib.diagnosis.engine.candidate_score import Score
from calib.diagnosis.engine.cross_validation_and_chance import residual_dispersion
from calib.diagnosis.engine.reduced_least_squares import (
    FrameProducts,
    Normal,
    normal_equations_by_direction_weights,
    solve_normal_equations,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import PlatformCandidate, PlatformScore
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel
from rig.array_and_json_types import Booleans, Floats

FREQUENCIES = 8  # bins of the coarse spectrum for each cycle that the highest frequency makes
ALIAS = 0.25  # of the spectral window's height from which a frequency mirrors a slow one
CLEAR = 4.0  # times the power that a slow change can mirror there, from which a frequency is one of its own
SLOWEST = 20  # cycles in the recording, below which it is a drift
OVERSAMPLED = 4  # frequencies looked at for each that the recording's length can tell apart
LEAST = 1e-12  # of the largest square of a direction, by which all are scaled at least
PEAKS = 6  # frequencies that are looked at closely
TICK = 1e-4  # s, to which exposures' times are compared
ROUNDS = 30  # of one factor after the other; each brings them nearer
SOFT = 1e-9  # of a direction's power, added so that those that move nothing can be solved for


def axis_elongations_by_sinusoidal_platform_motion(model: LinearisedModel, frequencies: Floats) -> Floats:
    """Axis elongations (k, F, a, 12) m by sinusoidal platform motion at frequencies (k,) Hz.

    Sine, then cosine, along each of six directions.
    """
    k = model.point
    modes = np.stack([k.swayed(np.tile(unit, (len(k.t), 1))) for unit in np.eye(6)], axis=-1)
    angle = 2 * np.pi * frequencies[:, None] * k.t
    return np.concatenate([np.sin(angle)[:, :, None, None] * modes, np.cos(angle)[:, :, None, None] * modes], axis=-1)


def best_vibration_frequency_score(
    model: LinearisedModel, candidate: PlatformCandidate, products: FrameProducts
) -> PlatformScore:
    """Score of the best vibration frequency, at which one direction shakes most.

    p-value by the number of frequencies that can be told apart.
    """
    t = model.point.t
    parameter = next(p for p in candidate.kind.parameters if p.role == "frequency")
    length, node = np.ptp(t) + 1e-9, candidate.grid[0]
    free = len(candidate.spec.linear) - candidate.tied
    high = min(parameter.usual[1], 0.5 / _tick(t))
    spectrum, window, frequency = _coarse(model, products, high)
    inside = (
        (frequency >= max(parameter.usual[0], SLOWEST / length))
        & (frequency <= high)
        & ~_mirrors_of_slow_changes(spectrum, window, length, high)
    )
    if not inside.any():
        return Score(
            candidate,
            {**node, "frequency": parameter.usual[0]},
            np.zeros(12),
            0.0,
            1.0,
            free + candidate.extra,
            1.0,
            0.0,
            np.zeros(1),
        )
    spectrum, frequency = spectrum[inside], frequency[inside]
    peaks = np.argpartition(spectrum, -min(PEAKS, len(spectrum)))[-PEAKS:]
    near = np.unique(np.concatenate([frequency[p] + np.linspace(-1, 1, 21) / (OVERSAMPLED * length) for p in peaks]))
    normal = normal_equations_by_direction_weights(
        products, axis_elongations_by_sinusoidal_platform_motion(model, near)
    )
    deltas, coefficients = (
        np.array(part) for part in zip(*(rank_one_direction_and_phase_fit(*pair) for pair in zip(normal.b, normal.G)))
    )
    best = int(np.argmax(deltas))
    seen = solve_normal_equations(Normal(*(part[best : best + 1] for part in normal))).seen[0]
    ratio = residual_dispersion(
        model.linear,
        products,
        axis_elongations_by_sinusoidal_platform_motion(model, near[best : best + 1])[0],
        coefficients[best],
    ).ratio
    delta = deltas[best] / ratio
    p = min(1.0, length * high * float(scipy.special.chdtrc(free, delta)))
    return Score(
        candidate,
        {**node, "frequency": float(near[best])},
        coefficients[best],
        float(delta),
        float(p),
        free + candidate.extra,
        ratio,
        float(seen),
        deltas / ratio,
    )


def rank_one_direction_and_phase_fit(b: Floats, G: Floats) -> tuple[float, Floats]:
    """Rank-one fit of a direction and a phase, normal equations G (12, 12) x = b (12,).

    Returns (drop, coefficients (12,))
    """
    own = np.diag(G)
    scale = np.sqrt(
        np.maximum(own, LEAST * max(own.max(), 0.0)) + 1e-300
    )  # a direction that nuisances take whole moves nothing
    whole = np.linalg.pinv(G / scale[:, None] / scale, rcond=1e-9, hermitian=True) @ (b / scale) / scale
    weight = np.maximum(scale.reshape(2, 6).max(axis=0), 1e-300)
    phase = np.linalg.svd(whole.reshape(2, 6) * weight, full_matrices=False)[0][:, 0]
    tensor, right = G.reshape(2, 6, 2, 6), b.reshape(2, 6)
    for _ in range(ROUNDS):
        H = np.einsum("p,piqj,q->ij", phase, tensor, phase)
        direction = np.linalg.lstsq(H / weight[:, None] / weight, phase @ right / weight, rcond=1e-9)[0] / weight
        new = np.linalg.lstsq(np.einsum("i,piqj,j->pq", direction, tensor, direction), right @ direction, rcond=None)[0]
        new, direction = new / np.linalg.norm(new), direction * np.linalg.norm(new)
        if np.abs(new - phase).max() < 1e-9:
            break
        phase = new
    x = np.outer(new, direction).ravel()
    return float(2 * b @ x - x @ G @ x), x


def _bins(length: float, high: float) -> tuple[int, float]:
    """(how many, s of one) of the times on which the coarse spectrum stands."""
    bins = next_fast_len(int(np.ceil(max(length, 1 / OVERSAMPLED) * high * FREQUENCIES)), real=True)
    return bins, length * OVERSAMPLED / bins


def _coarse(model: LinearisedModel, products: FrameProducts, high: float) -> tuple[Floats, Floats, Floats]:
    """(delta chi-square of all directions, spectral window of the exposures, Hz) up to beyond `high`.

    Nuisances and what frames weigh unevenly are left aside, in single precision: they find peaks alone.
    """
    t = model.point.t
    modes = axis_elongations_by_sinusoidal_platform_motion(model, np.zeros(1))[0, :, :, 6:]
    beta, power = (
        np.einsum("fad,fa->fd", modes, products.beta),
        np.einsum("fad,fab,fbe->de", modes, products.gamma, modes),
    )
    own = np.diag(power)
    half = np.linalg.cholesky(np.linalg.inv(power + SOFT * np.diag(np.maximum(own, SOFT * own.max()))))
    bins, step = _bins(np.ptp(t) + 1e-9, high)
    at = np.rint((t - t[0]) / step).astype(int)
    series = [np.bincount(at, weights=one, minlength=bins)[:bins] for one in (*(beta @ half).T, np.ones(len(t)))]
    found = rfft(np.array(series, np.float32), overwrite_x=True)
    square = found.real**2 + found.imag**2
    return 2 * square[:-1].sum(axis=0), np.sqrt(square[-1]) / len(t), cast(Floats, np.fft.rfftfreq(bins, step))


def _mirrors_of_slow_changes(spectrum: Floats, window: Floats, length: float, high: float) -> Booleans:
    """(bins,) bool: frequencies of a spectrum (bins,) that may mirror a drift, or cannot be told from none.

    What a slow change mirrors at a frequency is its power by the square of the spectral window (bins,) between the two,
    where that window is high.
    """
    bins, _ = _bins(length, high)
    high_at, mirrored = np.flatnonzero(window > ALIAS), np.zeros(len(spectrum))
    for slow in range(-SLOWEST * OVERSAMPLED, SLOWEST * OVERSAMPLED + 1):
        at = np.abs(high_at + slow)
        np.maximum.at(mirrored, np.minimum(at, bins - at), spectrum[abs(slow)] * window[high_at] ** 2)
    return spectrum < CLEAR * mirrored


def _tick(t: Floats) -> float:
    """s: the step of which all times (F,) are whole multiples; a frequency and its mirror images about 1 / tick look
    the same.
    """
    return np.gcd.reduce(np.rint((t - t[0]) / TICK).astype(int)) * TICK or TICK
