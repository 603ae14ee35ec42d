"""Distribution-free tolerance limits from order statistics, and the sample sizes they need.

With confidence c at least a share p of a population lies below the r-th smallest of n independent values once
P(Bin(n, p) <= r - 1) >= c; nothing is assumed of the distribution but that the sample was drawn from it. Between two
ranks the limit is interpolated by the chance that the quantile lies on either side, so that the confidence is met and
not overshot.
Sources: Wilks, Ann. Math. Statist. 12, 1941; Nyblom, Statistics and Probability Letters 14, 1992 (interpolated order
statistics).
docs/mathematics.md (24)
"""

from math import ceil, floor, log

import numpy as np
from scipy.special import betainc, xlogy

from rig.arrays import Floats
from rig.errors import NotEnoughData

TIGHT = 1e-12


def least_sample_size(coverage: float = 0.95, confidence: float = 0.95) -> int:
    """Least sample size whose greatest value bounds `coverage` with `confidence`: 59 for 0.95 and 0.95."""
    return ceil(log(1 - confidence) / log(coverage) - TIGHT)


def _reachable_confidence_and_coverage(n: int, coverage: float = 0.95, confidence: float = 0.95) -> tuple[float, float]:
    """(confidence reachable for that coverage, coverage reachable with that confidence) with n values."""
    return 1 - coverage**n, (1 - confidence) ** (1 / n) if n else 0.0


def require_sample_size(n: int, coverage: float, confidence: float, what: str = "distinct configurations") -> None:
    """Raise NotEnoughData where n is below the required sample size (`least_sample_size`)."""
    least = least_sample_size(coverage, confidence)
    if n < least:
        sure, share = _reachable_confidence_and_coverage(n, coverage, confidence)
        can = (
            f"they can speak for {share:.1%} of poses with {confidence:.1%} confidence, or for "
            f"{coverage:.0%} with {sure:.1%}: ask with "
            "--coverage or --confidence, or"
            if n
            else ""
        )
        raise NotEnoughData(
            f"{n} {what} held out and settled; that {coverage:.0%} of poses lie within a bound takes {least} with "
            f"{confidence:.0%} confidence. {can} record {least - n} more".replace(". record", ". Record")
        )


def count_beyond_upper_limit(n: int, coverage: float, confidence: float) -> float:
    """Count (real) of n values beyond the upper limit, at least 0.
    Raises NotEnoughData for fewer than `least_sample_size`
    """
    require_sample_size(n, coverage, confidence)
    return n - min(order_statistic_rank(n, coverage, 1 - confidence), float(n))


def count_beyond_lower_limit(n: int, coverage: float, confidence: float) -> float | None:
    """Count (real) of n values at the lower limit or beyond; None where n is too small."""
    found = order_statistic_rank(n, coverage, confidence)
    return None if found < 1 else n + 1 - found


def order_statistic_rank(n: int, coverage: float, chance: float) -> float:
    """Rank (real) of the order statistic below the `coverage` quantile with `chance`; 0 where none is.

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
    """Upper tolerance limit: `coverage` of the population lies below it, with `confidence`. values : (n,)
    values : (n,) drawn from it.

    Raises NotEnoughData for fewer than `least_sample_size`
    """
    n = len(values)
    return _at(np.sort(values), n - count_beyond_upper_limit(n, coverage, confidence))


def lower_tolerance_limit(values: Floats, coverage: float = 0.95, confidence: float = 0.95) -> float:
    """Lower tolerance limit: 1 - coverage of the population lies beyond it, with `confidence`. values : (n,) >= 0"""
    n = len(values)
    k = count_beyond_lower_limit(n, coverage, confidence)
    return 0.0 if k is None else _at(np.sort(values), n + 1 - k)


def _at(ordered: Floats, rank: float) -> float:
    """Value of a real rank, 1 for the smallest."""
    low = min(max(floor(rank), 1), len(ordered))
    high = min(low + 1, len(ordered))
    return float(ordered[low - 1] + (rank - low) * (ordered[high - 1] - ordered[low - 1]))


def coverage_log_likelihood_drop(n: int, beyond_it: float, coverage: float) -> float:
    """Drop of the log likelihood when `coverage` is forced on a limit that `beyond_it` of n values exceed."""
    share = beyond_it / n
    return float(n * (xlogy(share, share / (1 - coverage)) + xlogy(1 - share, (1 - share) / coverage)))
