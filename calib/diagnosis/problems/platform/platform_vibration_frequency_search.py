"""Search of the frequency at which a platform vibrates.

A coarse spectrum of all directions, then the exact score near its peak.
"""

import numpy as np
import scipy
from scipy.fft import fft

from calib.diagnosis.engine.candidate_scores_and_their_significance import Score
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import residual_dispersion
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    Normal,
    normal_equations_by_direction_weights,
    solve_normal_equations,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import PlatformCandidate, PlatformScore
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel
from rig.array_and_json_types import Booleans, Floats, Integers

FREQUENCIES = 8  # bins of the coarse spectrum for each cycle that the highest frequency makes
ALIAS = 0.25  # of the spectral window's height from which a frequency mirrors a slow one
CLEAR = 4.0  # times the power that a slow change can mirror there, from which a frequency is one of its own
SLOWEST = 20  # cycles in the recording, below which it is a drift
OVERSAMPLED = 4  # frequencies looked at for each that the recording's length can tell apart
LEAST = 1e-12  # of the largest square of a direction, by which all are scaled at least
PEAKS = 6  # frequencies that are looked at closely
SHOWN = 0.2  # of what a frequency explains, that a coarse spectrum shows at least: 0.38 by its bins, less by weights
TICK = 1e-4  # s, to which exposures' times are compared
ROUNDS = 30  # of one factor after the other; each brings them nearer
COMB = 4096  # times of one short transform of the coarse spectrum; a power of two
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
    model: LinearisedModel, candidate: PlatformCandidate, products: FrameProducts, least_delta_chi2: float = -np.inf
) -> PlatformScore:
    """Score of the best vibration frequency.

    One direction shakes most at it.
    p-value by the number of frequencies that can be told apart. least_delta_chi2 : what cannot explain as much is not
    looked at closely
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
    if not inside.any() or spectrum[inside].max() < SHOWN * least_delta_chi2:
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
    deltas, coefficients = rank_one_direction_and_phase_fits(normal.b, normal.G)
    best = int(np.argmax(deltas))
    seen = solve_normal_equations(Normal(*(part[best : best + 1] for part in normal[:3]))).seen[0]
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


def rank_one_direction_and_phase_fits(b: Floats, G: Floats) -> tuple[Floats, Floats]:
    """Rank-one fits of a direction and a phase, of k normal equations G (k, 12, 12) x = b (k, 12).

    Returns (drops (k,), coefficients (k, 12))
    """
    own = np.einsum("kii->ki", G)
    scale = np.sqrt(
        np.maximum(own, LEAST * np.maximum(own.max(axis=1, keepdims=True), 0.0)) + 1e-300
    )  # a direction that nuisances take whole moves nothing
    scaled = G / scale[:, :, None] / scale[:, None, :]
    whole = _solved(scaled, b / scale, 1e-9) / scale
    weight = np.maximum(scale.reshape(-1, 2, 6).max(axis=1), 1e-300)
    phase = np.linalg.svd(whole.reshape(-1, 2, 6) * weight[:, None], full_matrices=False)[0][:, :, 0]
    tensor, right, x = G.reshape(-1, 2, 6, 2, 6), b.reshape(-1, 2, 6), np.zeros(b.shape)
    going = np.arange(len(b))
    for _ in range(ROUNDS):
        now, T, r, w = phase[going], tensor[going], right[going], weight[going]
        H = np.einsum("kp,kpiqj,kq->kij", now, T, now) / w[:, :, None] / w[:, None, :]
        direction = _solved(H, np.einsum("kp,kpi->ki", now, r) / w, 1e-9) / w
        new = _solved(np.einsum("ki,kpiqj,kj->kpq", direction, T, direction), np.einsum("kpi,ki->kp", r, direction))
        size = np.linalg.norm(new, axis=1, keepdims=True)
        new = new / size
        x[going] = (new[:, :, None] * (direction * size)[:, None, :]).reshape(-1, 12)
        phase[going] = new
        going = going[np.abs(new - now).max(axis=1) >= 1e-9]
        if not len(going):
            break
    return 2 * np.einsum("ki,ki->k", b, x) - np.einsum("ki,kij,kj->k", x, G, x), x


def _solved(matrices: Floats, right: Floats, rcond: float = 1e-15) -> Floats:
    """(k, n) least-squares solutions of the smallest size, of symmetric matrices (k, n, n)."""
    return (np.linalg.pinv(matrices, rcond=rcond, hermitian=True) @ right[..., None])[..., 0]


def _bins(length: float, high: float) -> tuple[int, float]:
    """(how many, s of one) of the times on which the coarse spectrum stands."""
    bins = max(1, int(np.ceil(max(length, 1 / OVERSAMPLED) * high * FREQUENCIES / COMB))) * COMB
    return bins, length * OVERSAMPLED / bins


def power_spectrum_at_sparse_times(series: Floats, at: Integers, bin_count: int) -> Floats:
    """Power spectrum (bin_count // 2 + 1,) of series (s, F) with values at few of `bin_count` times.

    The sum over the series of the squares of their discrete Fourier transforms, in the square of their unit.
    at : (F,) bin of each; bin_count : a multiple of COMB. The frequencies a + A b, A = bin_count / COMB, of one a are
    one transform of COMB times of the series turned by a: many short ones stay in the processor's cache. Single
    precision.
    """
    apart, order = bin_count // COMB, np.argsort(at % COMB)
    teeth, first = np.unique(at[order] % COMB, return_index=True)
    turns = np.arange(apart // 2 + 1)
    turned = np.exp(-2j * np.pi / bin_count * np.outer(turns, at[order])).astype(np.complex64)
    square = np.zeros((len(turns), COMB), np.float32)
    for one in series[:, order].astype(np.float32):
        comb = np.zeros(square.shape, np.complex64)
        comb[:, teeth] = np.add.reduceat(turned * one, first, axis=1)
        parts = fft(comb, axis=1, overwrite_x=True).view(np.float32)
        parts *= parts
        square += parts[:, ::2]
        square += parts[:, 1::2]
    mirrored = square[(apart - 1) // 2 : 0 : -1, : COMB // 2 - 1 : -1]  # of real series: what of a is, of A - a
    return np.append(np.concatenate([square[:, : COMB // 2], mirrored]).ravel("F"), square[0, COMB // 2])


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
    window = np.sqrt(power_spectrum_at_sparse_times(np.ones((1, len(t))), at, bins)) / len(t)
    power = 2 * power_spectrum_at_sparse_times((beta @ half).T, at, bins)
    return power, window, np.arange(bins // 2 + 1) / (bins * step)


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
