"""How far poses truly lie from where they should, told from errors that were measured with noise.

What is measured is e = t + n: t the pose's own error, of which nothing is assumed, n the instrument's noise, of known size. With noise alike
in all directions the length |e| depends on the length |t| alone, so that the lengths' distribution G is a mixture over |t|, and
what share of it lies beyond Q is judged by the likelihood, maximised over all G (Kiefer and Wolfowitz, 1956) with that share held: a
nonparametric likelihood ratio (Owen, 1988). By how much it may fall is taken from the binomial distribution, so that without noise the
limits are the order statistics of `tolerance_limits`. Never is more noise taken off than the errors show, and where the likelihood
says less than the measured lengths themselves, theirs stand.
docs/mathematics.md (25)
"""

from dataclasses import dataclass

import numpy as np

from calib.certify import tolerance_limits

STEPS_PER_SIGMA = 2.0  # grid of lengths
FINEST = 400  # points of it; where more were needed, noise is too small to matter
TAIL = 6.0  # sigma beyond the greatest length
GAP = 0.02  # of the log likelihood, by which a maximum may be missed
ROUNDS = 4000
DIMENSIONS = 3  # of a position, of a rotation


@dataclass(frozen=True, slots=True)
class Limits:
    """Of the length below which a share of all poses lies: estimate, and one-sided limits (lower, upper), each with the confidence asked for."""

    estimate: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Lengths rho (m,) that |t| may have, and likelihood (n, m) of each measured length given each."""

    rho: np.ndarray
    likelihood: np.ndarray

    def best(self, split: int, tail: tuple[float, float], start: np.ndarray) -> tuple[float, np.ndarray]:
        """(log likelihood, weights (m,)) at its greatest with the share of rho[split:] held between tail's two; start : (m,) weights to go from."""
        w, L, n = start, self.likelihood, len(self.likelihood)
        for _ in range(ROUNDS):
            w = _held(w, split, tail)
            f = L @ w
            g = L.T @ (1 / f)
            low, high = g[:split].max(initial=0.0), g[split:].max(initial=0.0)
            share = tail[1] if high > low else tail[0]
            if share * high + (1 - share) * low - n < GAP:
                break
            w = w * g / n
        return float(np.log(L @ _held(w, split, tail)).sum()), w


def _held(w: np.ndarray, split: int, tail: tuple[float, float]) -> np.ndarray:
    """Weights (m,) scaled so that w[split:] has a share between tail's two."""
    beyond = w[split:].sum()
    held = min(max(beyond, tail[0]), tail[1])
    return w if held == beyond else np.concatenate([w[:split] * ((1 - held) / (w.sum() - beyond)), w[split:] * (held / beyond)])


def mixture(lengths: np.ndarray, sigma: np.ndarray) -> Mixture | None:
    """Mixture of measured lengths (n,) with noise sigma (n,) per direction; None where noise is too small to matter."""
    top = lengths.max() + TAIL * sigma.max()
    count = int(np.ceil(STEPS_PER_SIGMA * top / max(np.median(sigma), 1e-300)))
    if count > FINEST:
        return None
    rho = np.linspace(0, top, max(count, 8))
    s2 = sigma[:, None] ** 2
    kappa = np.maximum(lengths[:, None] * rho / s2, 1e-12)
    exponent = -((lengths[:, None] - rho) ** 2) / (2 * s2)
    likelihood = np.exp(exponent - exponent.max(axis=1, keepdims=True)) * -np.expm1(-2 * kappa) / (2 * kappa)
    return Mixture(rho, likelihood / likelihood.max(axis=1, keepdims=True))


def limits(lengths: np.ndarray, sigma: np.ndarray, coverage: float = 0.95, confidence: float = 0.95) -> Limits:
    """Limits of true lengths. lengths : (n,) m or rad, measured; sigma : (n,) standard deviation of their noise in each direction.

    Raises NotEnoughData for fewer than tolerance_limits.smallest
    """
    n = len(lengths)
    plain = tolerance_limits.lower(lengths, coverage, confidence), tolerance_limits.upper(lengths, coverage, confidence)
    most = np.sqrt((lengths**2).sum() / max(DIMENSIONS * (sigma**2).sum(), 1e-300))  # by which noise may be scaled before it is all there is
    found = mixture(lengths, sigma * min(1.0, most))
    if found is None:
        return Limits(float(np.quantile(lengths, coverage)), *plain)
    m = len(found.rho)
    top, free = found.best(m, (0.0, 0.0), np.full(m, 1 / m))
    middle = float(found.rho[min(int(np.searchsorted(np.cumsum(free), coverage)), m - 1)])
    allowed = tolerance_limits.drop(n, tolerance_limits.beyond(n, coverage, confidence), coverage)
    high = _crossing(found, free, top, allowed, 1 - coverage, middle, True)
    k = tolerance_limits.within(n, coverage, confidence)
    low = 0.0 if k is None else _crossing(found, free, top, tolerance_limits.drop(n, k, coverage), 1 - coverage, middle, False)
    high = min(high, plain[1])  # noise makes lengths longer, so that the limit of those measured is one as well
    return Limits(min(middle, high), min(low, middle, high), high)


def _crossing(found: Mixture, free: np.ndarray, top: float, allowed: float, share: float, middle: float, up: bool) -> float:
    """Length at which the log likelihood has fallen by `allowed` when at least (up) or at most (down) `share` is held beyond it."""
    rho, m = found.rho, len(found.rho)
    floor = free + 1e-6 / m  # no weight is nothing, or it could not come back

    def fallen(split: int) -> float:
        w = floor / floor.sum()
        return top - found.best(split, (share, 1.0) if up else (0.0, share), w)[0]

    start = int(np.searchsorted(rho, middle))
    inside, outside = (start, m) if up else (start, 0)
    at_inside, at_outside = 0.0, np.inf
    while abs(outside - inside) > 1:
        half = (inside + outside) // 2
        value = fallen(half)
        inside, outside, at_inside, at_outside = (half, outside, value, at_outside) if value <= allowed else (inside, half, at_inside, value)
    edge = rho[min(inside, m - 1)]
    if not np.isfinite(at_outside) or at_outside <= at_inside:
        return float(edge)
    part = float(np.clip((allowed - at_inside) / (at_outside - at_inside), 0, 1))
    return float(edge + part * (rho[min(outside, m - 1)] - edge))
