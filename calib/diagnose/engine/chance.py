"""How likely a score is by chance over a search, and how much more frames scatter than their covariance says.

Where a candidate was searched over a nonlinear parameter that means nothing under the null, its greatest delta chi-square is not
chi-square: Davies' bound is used (Biometrika 74, 1987, 33-43, eq. 3.4), the search's own variation standing for the expected
upcrossings. Over candidates the bound is Bonferroni's. The dispersion is the sandwich's (White, Econometrica 48, 1980, 817-838).
"""

from typing import NamedTuple

import numpy as np
import scipy
from scipy.special import gammaln

from calib.diagnose.engine.linear import LinearModel
from calib.diagnose.engine.products import SWALLOWED, FrameProducts

Z95 = 1.959964  # normal quantile of a 95 % interval
MANY = 2000  # frames from which Fisher's F is chi-square


class Dispersion(NamedTuple):
    """ratio : how much more frames' contributions to the projections scatter than the covariance says, at least 1
    active : frames that contribute"""

    ratio: float
    active: int


def davies(deltas: np.ndarray, rank: float, frames: int) -> float:
    """p-value of the greatest delta chi-square of deltas (k,), scanned in order with `rank` linear parameters; Fisher's F stands for
    chi-square where frames are few."""
    top = max(float(deltas.max()), 1e-12)
    rank = max(int(rank), 1)
    tail = scipy.special.fdtrc(rank, max(frames - rank, 1), top / rank) if frames < MANY else scipy.special.chdtrc(rank, top)
    if len(deltas) == 1:
        return float(tail)
    variation = np.abs(np.diff(np.sqrt(np.maximum(deltas, 0)))).sum()
    half = rank / 2
    log_bound = np.log(max(variation, 1e-12)) + (half - 0.5) * np.log(top) - top / 2 - half * np.log(2) - gammaln(half)
    heavier = tail / max(scipy.special.chdtrc(rank, top), 1e-300)  # what few frames add to the tail, added to the bound as well
    return float(min(1.0, tail + np.exp(min(log_bound, 0)) * min(max(heavier, 1.0), 1e6)))


def dispersion(model: LinearModel, products: FrameProducts, weights: np.ndarray, coefficients: np.ndarray, cluster: int = 1) -> Dispersion:
    """Dispersion of a candidate of weights (F, a, q) and coefficients (q,); cluster : frames in a row that are taken together."""
    F, a, q = weights.shape
    turned = np.swapaxes(weights, 1, 2)
    pushed = products.gamma * weights if a == 1 else products.gamma @ weights
    K = products.onto(weights.reshape(F * a, q).T @ products.kappa.reshape(F * a, -1))
    reach = K.T @ coefficients
    along = products.kappa @ products.of_columns(np.column_stack([reach, K.T]))  # (F, a, 1 + q)
    own = products.beta - pushed @ coefficients + along[..., 0]  # products with what the fit leaves
    moved = ((weights @ coefficients)[..., None] * along[..., 1:]).sum(axis=1)
    contributions = (turned @ own[..., None])[..., 0] - model.leakage(reach, K) + moved
    before = np.einsum("faq,faq->q", weights, pushed)
    bread = before - (K**2).sum(axis=1)
    seen = bread > SWALLOWED * before
    if cluster > 1:
        starts = np.arange(0, len(contributions), cluster)
        contributions = np.add.reduceat(contributions, starts, axis=0)
    meat = (contributions**2).sum(axis=0)
    active = int(pushed.any(axis=(1, 2)).sum())
    few = active / max(active - len(coefficients), 1)
    ratio = meat[seen] / bread[seen]
    return Dispersion(max(1.0, float(ratio.mean() if seen.any() else 1.0) * few), active)
