"""Noise-free errors, and tolerance limits.

Errors estimated from errors measured with noise; limits that assume no distribution.

With confidence c at least a share p of a population lies below the r-th smallest of n independent values once
P(Bin(n, p) <= r - 1) >= c; nothing is assumed of the distribution but that the sample was drawn from it. Between two
ranks the limit is interpolated by the chance that the quantile lies on either side, so that the confidence is met and
not overshot.
Sources: Wilks, Ann. Math. Statist. 12, 1941; Nyblom, Statistics and Probability Letters 14, 1992 (interpolated order
statistics).
docs/mathematics.md (24)

What is measured is e = t + n: t the pose's own error, of which nothing is assumed, n the instrument's noise, of known
size. With noise alike in all directions the length |e| depends on the length |t| alone. A pose has one such length, or
two, of position and of rotation, each in units of its own, and its depth is the greater of them. The measured lengths'
distribution is a mixture over the true ones, and what share of these has a depth beyond Q is judged by the likelihood,
maximised over all distributions (Kiefer and Wolfowitz, 1956) with that share held: a nonparametric likelihood ratio
(Owen, 1988). By how much it may fall is taken from the binomial distribution, so that without noise the limits are the
order statistics of `tolerance_limits`. Never is more noise taken off than the errors show, and where the likelihood
says less than the measured depths themselves, theirs stand.
docs/mathematics.md (25)
"""

from dataclasses import dataclass
from math import ceil, floor, log
from typing import NamedTuple, cast

import numpy as np
import scipy
from scipy.special import betainc, i0e, xlogy

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotEnoughData

ROUNDING = 1e-12


def least_sample_size(coverage: float = 0.95, confidence: float = 0.95) -> int:
    """Least sample size whose greatest value bounds `coverage` with `confidence`.

    It is 59 for 0.95 and 0.95.
    """
    return ceil(log(1 - confidence) / log(coverage) - ROUNDING)


def _reachable_confidence_and_coverage(n: int, coverage: float = 0.95, confidence: float = 0.95) -> tuple[float, float]:
    """(confidence reachable for that coverage, coverage reachable with that confidence) with n values."""
    return 1 - coverage**n, (1 - confidence) ** (1 / n) if n else 0.0


def require_sample_size(
    n: int, coverage: float, confidence: float, sample_description: str = "distinct configurations"
) -> None:
    """Raise NotEnoughData where n is below the required sample size (`least_sample_size`)."""
    least = least_sample_size(coverage, confidence)
    if n < least:
        sure, share = _reachable_confidence_and_coverage(n, coverage, confidence)
        can = (
            f"they support a statement on {share:.1%} of poses with {confidence:.1%} confidence, or for "
            f"{coverage:.0%} with {sure:.1%}: request it with "
            "--coverage or --confidence, or"
            if n
            else ""
        )
        raise NotEnoughData(
            f"{n} {sample_description} held out and at rest; that {coverage:.0%} of poses lie within a bound requires "
            f"{least} with {confidence:.0%} confidence. {can} record {least - n} more".replace(". record", ". Record")
        )


def fractional_count_beyond_upper_tolerance_limit(n: int, coverage: float, confidence: float) -> float:
    """Number of n values beyond the upper tolerance limit, as a real number of at least 0.
    Raises NotEnoughData for fewer than `least_sample_size`
    """
    require_sample_size(n, coverage, confidence)
    return n - min(rank_below_quantile(n, coverage, 1 - confidence), float(n))


def fractional_count_beyond_lower_quantile_limit(n: int, coverage: float, confidence: float) -> float | None:
    """Number of n values at or beyond the lower limit, as a real number.

    None where n is too small.
    """
    found = rank_below_quantile(n, coverage, confidence)
    return None if found < 1 else n + 1 - found


def rank_below_quantile(n: int, coverage: float, chance: float) -> float:
    """Rank (real) of the order statistic below the `coverage` quantile with `chance`.

    It is 0 where none is.

    Near the quantile the gaps to its neighbours X_r and X_(r+1) are as good as exponential, at the rates r / p and (n -
    r) / (1 - p)
    """
    ranks = np.arange(n + 1)
    below = np.append(1.0, betainc(ranks[1:], n - ranks[1:] + 1, coverage))  # chance that X_r lies below the quantile
    r = int(np.flatnonzero(below >= chance)[-1])
    if r in (0, n):
        return float(r)
    odds = (chance - below[r + 1]) / max(below[r] - chance, 1e-300)
    return r + 1 / (1 + odds * r * (1 - coverage) / ((n - r) * coverage))


def upper_tolerance_limit(values: Floats, coverage: float = 0.95, confidence: float = 0.95) -> float:
    """Upper tolerance limit.

    `coverage` of the population lies below it, with `confidence`.
    values : (n,) drawn from it.
    Raises NotEnoughData for fewer than `least_sample_size`
    """
    n = len(values)
    return _at(np.sort(values), n - fractional_count_beyond_upper_tolerance_limit(n, coverage, confidence))


def lower_confidence_limit_of_quantile(values: Floats, coverage: float = 0.95, confidence: float = 0.95) -> float:
    """Lower confidence limit of the `coverage` quantile of a population, from values (n,) >= 0 drawn from it.

    1 - coverage of the population lies beyond it, with `confidence`.
    """
    n = len(values)
    k = fractional_count_beyond_lower_quantile_limit(n, coverage, confidence)
    return 0.0 if k is None else _at(np.sort(values), n + 1 - k)


def _at(ordered: Floats, rank: float) -> float:
    """Value of a real rank, 1 for the smallest."""
    low = min(max(floor(rank), 1), len(ordered))
    high = min(low + 1, len(ordered))
    return float(ordered[low - 1] + (rank - low) * (ordered[high - 1] - ordered[low - 1]))


def coverage_log_likelihood_drop(n: int, count_beyond_limit: float, coverage: float) -> float:
    """Drop of the log likelihood when `coverage` is forced on a limit.

    A limit that `count_beyond_limit` of n values exceed.
    """
    share = count_beyond_limit / n
    return float(n * (xlogy(share, share / (1 - coverage)) + xlogy(1 - share, (1 - share) / coverage)))


STEPS_PER_SIGMA = 2.0  # grid of lengths
FINEST = {
    1: 400,
    2: 100,
}  # points of it, by how many lengths a pose has; where more were needed, noise is too small to matter
TAIL = 6.0  # sigma beyond the greatest length
GAP = 0.02  # of the log likelihood, by which a maximum may be missed
ROUNDS = 200
FRESH = 8  # parts of the grid, each of which may add one point to a maximum in a round
TIGHT = 1e3  # weight of the shares in a round's least squares
DIMENSIONS = 3  # of a position, of a rotation; a direction's error has 2


@dataclass(frozen=True, slots=True)
class Limits:
    """Of the depth below which a share of all poses lies: estimate, and one-sided limits (lower, upper), each with the
    confidence requested.
    """

    estimate: float
    lower: float
    upper: float


class Maximum(NamedTuple):
    """value : log likelihood; at : (s,) indices of the grid; weights : (s,) there"""

    value: float
    at: Integers
    weights: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """depth : (m,) ascending, of the true lengths that a pose may have; likelihood : (n, m) of each pose's measured
    lengths given each.
    """

    depth: Floats
    likelihood: Floats

    def best(self, split: int = 0, share: float = 1.0, start: Maximum | None = None) -> Maximum:
        """Maximum of the likelihood with `share` of the weight held at depth[split:]; of -inf where that leaves no
        place for the rest.

        By constrained Newton steps over the few points that bear weight (Wang, J. R. Statist. Soc. B 69, 2007), to
        within GAP
        """
        m = len(self.depth)
        groups = [
            (slice(low, high), part) for low, high, part in ((0, split, 1 - share), (split, m, share)) if part > 0
        ]
        if any(g.stop == g.start for g, _ in groups):
            return Maximum(-np.inf, np.zeros(0, int), np.zeros(0))
        w = self._first(groups, start)
        for _ in range(ROUNDS):
            f = self.likelihood[:, w.at] @ w.weights
            gradient = (1 / f) @ self.likelihood
            if sum(part * gradient[g].max() for g, part in groups) - len(f) < GAP:
                break
            w = self._step(w, f, gradient, groups)
        return w

    def _first(self, groups: list[tuple[slice, float]], start: Maximum | None) -> Maximum:
        """Where to begin: the weights of `start`, or the likeliest point of each pose, with the shares held."""
        at: Integers
        weights: Floats | Integers
        own = np.argmax(self.likelihood, axis=1)
        at, weights = np.unique(own, return_counts=True) if start is None else (start.at, start.weights)
        fresh = [
            g.start + int(np.argmax(self.likelihood[:, g].sum(axis=0)))
            for g, _ in groups
            if not ((at >= g.start) & (at < g.stop)).any()
        ]
        at, weights = np.append(at, fresh).astype(int), cast(Floats, np.append(weights, np.ones(len(fresh))))
        weights = _held(at, weights, groups)
        return Maximum(self._value(at, weights), at, weights)

    def _step(self, w: Maximum, f: Floats, gradient: Floats, groups: list[tuple[slice, float]]) -> Maximum:
        """A Newton step over the points that bear weight and those that the gradient adds, shortened until the
        likelihood grows.
        """
        parts = [part for g, _ in groups for part in np.array_split(np.arange(g.start, g.stop), FRESH) if len(part)]
        found = [part[np.argmax(gradient[part])] for part in parts]
        at = np.append(w.at, np.setdiff1d(found, w.at))
        old = np.append(w.weights, np.zeros(len(at) - len(w.at)))
        rows = [
            self.likelihood[:, at] / f[:, None],
            *(TIGHT * ((at >= g.start) & (at < g.stop))[None] for g, _ in groups),
        ]
        goal = np.append(np.full(len(f), 2.0), [TIGHT * part for _, part in groups])
        new = _held(at, scipy.optimize.nnls(np.vstack(rows), goal, maxiter=50 * len(at))[0], groups)
        rise = float(gradient[at] @ (new - old))
        for _ in range(30):
            value = self._value(at, new)
            if value >= w.value + rise / 3:
                break
            new, rise = (new + old) / 2, rise / 2
        else:
            return w
        alive = new > 0
        return Maximum(value, at[alive], new[alive])

    def _value(self, at: Integers, weights: Floats) -> float:
        with np.errstate(divide="ignore"):
            return float(np.log(self.likelihood[:, at] @ weights).sum())


def _held(at: Integers, weights: Floats | Integers, groups: list[tuple[slice, float]]) -> Floats:
    """Weights scaled so that each group has its share."""
    out = np.zeros(len(weights))
    for g, part in groups:
        inside = (at >= g.start) & (at < g.stop)
        own = weights * inside
        out += own * (part / own.sum()) if own.sum() > 0 else inside * (part / max(inside.sum(), 1))
    return out


def _fit_depth_mixture(lengths: Floats, sigma: Floats, dimensions: int) -> Mixture | None:
    """Mixture of measured lengths (n, d) with noise sigma (n, d) per direction; None where all noise is too small to
    matter.

    Noise of one of two lengths that alone is too small stands at the least that the grid resolves, 1/50 of the greatest
    length
    """
    finest = FINEST[lengths.shape[1]]
    tops = (lengths + TAIL * sigma).max(axis=0)
    counts = np.ceil(STEPS_PER_SIGMA * tops / np.maximum(np.median(sigma, axis=0), 1e-300))
    if (counts > finest).all():
        return None
    depth, likelihood = np.zeros(1), np.ones((len(lengths), 1))
    for r, s, top, count in zip(lengths.T, sigma.T, tops, counts):
        rho = np.linspace(0, top, int(np.clip(count, 8, finest)))
        noise = np.maximum(s, 1e-300) if count <= finest else np.maximum(s, STEPS_PER_SIGMA * rho[1])
        one = _likelihood(r, noise, rho, dimensions)
        depth = np.maximum(depth[:, None], rho).ravel()
        likelihood = (likelihood[:, :, None] * one[:, None]).reshape(len(lengths), -1)
    order = np.argsort(depth, kind="stable")
    return Mixture(depth[order], likelihood[:, order])


def _likelihood(lengths: Floats, sigma: Floats, rho: Floats, dimensions: int) -> Floats:
    """(n, m) of measured lengths (n,) with noise (n,) given true ones (m,), each row's greatest 1.

    A length in three dimensions is that of Maxwell's distribution off its centre, in two that of Rice's.
    """
    s2 = sigma[:, None] ** 2
    kappa = np.maximum(lengths[:, None] * rho / s2, 1e-12)
    exponent = -((lengths[:, None] - rho) ** 2) / (2 * s2)
    shape = i0e(kappa) if dimensions == 2 else -np.expm1(-2 * kappa) / (2 * kappa)
    likelihood = np.exp(exponent - exponent.max(axis=1, keepdims=True)) * shape
    return likelihood / likelihood.max(axis=1, keepdims=True)


def tolerance_limits_of_true_errors(
    lengths: Floats, sigma: Floats, coverage: float = 0.95, confidence: float = 0.95, dimensions: int = DIMENSIONS
) -> Limits:
    """Tolerance limits of true error lengths, estimated from lengths measured with noise.

    Of d limits the greatest.
    lengths : (n,) or (n, d) measured, in units of each; sigma : alike, standard deviation of their noise in each
    direction; dimensions : of the errors whose lengths these are, 3 or 2

    Raises NotEnoughData for fewer than `least_sample_size`
    """
    n = len(lengths)
    lengths, sigma = lengths.reshape(n, -1), sigma.reshape(n, -1)
    measured = lengths.max(axis=1)
    plain = (
        lower_confidence_limit_of_quantile(measured, coverage, confidence),
        upper_tolerance_limit(measured, coverage, confidence),
    )
    most = np.sqrt(
        (lengths**2).sum(axis=0) / np.maximum(dimensions * (sigma**2).sum(axis=0), 1e-300)
    )  # beyond which noise is all there is
    found = _fit_depth_mixture(lengths, sigma * np.minimum(1.0, most), dimensions)
    if found is None:
        return Limits(float(np.quantile(measured, coverage)), *plain)
    free = found.best()
    order = np.argsort(free.at)
    middle = float(
        found.depth[free.at[order[min(int(np.searchsorted(np.cumsum(free.weights[order]), coverage)), len(order) - 1)]]]
    )
    allowed = coverage_log_likelihood_drop(
        n, fractional_count_beyond_upper_tolerance_limit(n, coverage, confidence), coverage
    )
    high = _crossing(found, free, allowed, 1 - coverage, middle, True)
    k = fractional_count_beyond_lower_quantile_limit(n, coverage, confidence)
    low = (
        0.0
        if k is None
        else _crossing(found, free, coverage_log_likelihood_drop(n, k, coverage), 1 - coverage, middle, False)
    )
    high = min(high, plain[1])  # noise makes lengths longer, so that the limit of those measured is one as well
    return Limits(min(middle, high), min(low, middle, high), high)


def _crossing(found: Mixture, free: Maximum, allowed: float, share: float, middle: float, up: bool) -> float:
    """Depth at which the log likelihood has fallen by `allowed` when at least (up) or at most (not up) `share` is held
    beyond it.
    """
    depths, splits = np.unique(found.depth, return_index=True)

    def fallen(k: int) -> float:
        split = int(splits[k])
        beyond = float(free.weights[free.at >= split].sum())
        if beyond >= share if up else beyond <= share:
            return 0.0
        return free.value - found.best(split, share, free).value

    start = int(np.searchsorted(depths, middle))
    inside, outside = (start, len(depths)) if up else (start, 0)
    at_inside, at_outside = 0.0, np.inf
    while abs(outside - inside) > 1:
        half = (inside + outside) // 2
        value = fallen(half)
        inside, outside, at_inside, at_outside = (
            (half, outside, value, at_outside) if value <= allowed else (inside, half, at_inside, value)
        )
    edge = depths[min(inside, len(depths) - 1)]
    if not np.isfinite(at_outside) or at_outside <= at_inside:
        return float(edge)
    part = float(np.clip((allowed - at_inside) / (at_outside - at_inside), 0, 1))
    return float(edge + part * (depths[min(outside, len(depths) - 1)] - edge))
