"""Probability that a scan's best score arises by chance, and the residuals' dispersion beyond their covariance.

Where a candidate was searched over a nonlinear parameter that means nothing under the null, its greatest delta
chi-square is not chi-square: Davies' bound is used (Biometrika 74, 1987, 33-43, eq. 3.4), the search's own variation
standing for the expected upcrossings. Over candidates the bound is Bonferroni's. The dispersion is the sandwich's
(White, Econometrica 48, 1980, 817-838), as the mean of its eigenvalues (Rao and Scott, JASA 76, 1981, 221-230), as firm
as the frames that it is told by (Bell and McCaffrey, Survey Methodology 28, 2002, 169-181).
"""

from typing import NamedTuple

import numpy as np
import scipy
from scipy.special import gammaln

from calib.diagnosis.engine.frame_inner_products import SWALLOWED, FrameProducts
from calib.diagnosis.engine.linear_model import LinearModel
from rig.array_types import Floats

# value, low, high of a number, or of the numbers of a vector
Interval = tuple[float, float, float] | tuple[list[float], list[float], list[float]]
Z95 = 1.959964  # normal quantile of a 95 % interval
# degrees of freedom below which clusters show nothing of how they differ: what lies in one or two is judged frame by
# frame
FEW = 4.0
MANY = 2000  # degrees of freedom from which Fisher's F is chi-square


class Dispersion(NamedTuple):
    """ratio : how much more frames' contributions to the projections scatter than the covariance says, at least 1
    freedom : degrees of freedom by which the contributions tell that"""

    ratio: float
    freedom: float


def scan_p_value(deltas: Floats, rank: float, freedom: float) -> float:
    """p-value of the greatest delta chi-square of deltas (k,), scanned in order with `rank` linear parameters; Fisher's
    F stands for chi-square where the degrees of freedom of what deltas were divided by are few."""
    top = max(float(deltas.max()), 1e-12)
    rank = max(int(rank), 1)
    tail = (
        scipy.special.fdtrc(rank, max(freedom, 1.0), top / rank) if freedom < MANY else scipy.special.chdtrc(rank, top)
    )
    if len(deltas) == 1:
        return float(tail)
    variation = np.abs(np.diff(np.sqrt(np.maximum(deltas, 0)))).sum()
    half = rank / 2
    log_bound = np.log(max(variation, 1e-12)) + (half - 0.5) * np.log(top) - top / 2 - half * np.log(2) - gammaln(half)
    heavier = tail / max(
        scipy.special.chdtrc(rank, top), 1e-300
    )  # what few frames add to the tail, added to the bound as well
    return float(min(1.0, tail + np.exp(min(log_bound, 0)) * min(max(heavier, 1.0), 1e6)))


def residual_dispersion(
    model: LinearModel, products: FrameProducts, weights: Floats, coefficients: Floats, correlated_frames: int = 1
) -> Dispersion:
    """Dispersion of a candidate of weights (F, a, q) and coefficients (q,); cluster : frames in a row that are taken
    together.
    """
    F, a, q = weights.shape
    turned = np.swapaxes(weights, 1, 2)
    pushed = products.gamma * weights if a == 1 else products.gamma @ weights
    K = products.onto(weights.reshape(F * a, q).T @ products.kappa.reshape(F * a, -1))
    reach = K.T @ coefficients
    along = products.kappa @ products.of_columns(np.column_stack([reach, K.T]))  # (F, a, 1 + q)
    own = products.beta - pushed @ coefficients + along[..., 0]  # products with what the fit leaves
    moved = ((weights @ coefficients)[..., None] * along[..., 1:]).sum(axis=1)
    contributions = (turned @ own[..., None])[..., 0] - model.leakage(reach, K) + moved
    own_rows = turned @ pushed
    across = turned @ along[..., 1:]
    squares = (
        own_rows - across - np.swapaxes(across, 1, 2) + model.carried(K)
    )  # (F, q, q) of the directions, nuisances taken out
    half = _seen(own_rows.sum(axis=0), K)
    rank = half.shape[1]
    if not rank:
        return Dispersion(1.0, 1.0)
    shares = half.T @ squares @ half
    expected, freedom = _expected(shares)
    if correlated_frames > 1:
        starts = np.arange(0, F, correlated_frames)
        several = _expected(np.add.reduceat(shares, starts, axis=0))
        if several[1] >= FEW:
            (expected, freedom), contributions = several, np.add.reduceat(contributions, starts, axis=0)
    if expected < SWALLOWED * rank:  # one frame shows it all, and nothing of how frames differ
        return Dispersion(1.0, 1.0)
    ratio = float(((contributions @ half) ** 2).sum()) / expected
    return Dispersion(max(1.0, ratio), max(1.0, freedom))


def _seen(before: Floats, K: Floats) -> Floats:
    """(q, r) combinations of a candidate's directions that are orthonormal, nuisances taken out, of those that these
    leave visible.
    before : (q, q) products of the directions with nuisances in; K : (q, p) with the nuisances' orthonormal basis"""
    scale = np.sqrt(np.maximum(np.diag(before), 1e-300))
    values, vectors = np.linalg.eigh((before - K @ K.T) / scale[:, None] / scale)
    kept = values > SWALLOWED
    return vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]


def _expected(shares: Floats) -> tuple[float, float]:
    """(mean, degrees of freedom by Satterthwaite) of contributions squared whose covariances are as stated, the
    candidate fitted: r - r / F and r (F - 1) where F frames say as much of r directions each; less of both where a few
    frames say most.
    shares : (F, r, r) that frames have in what is known of the directions"""
    square = shares @ shares
    total = square.sum(axis=0)
    mean = shares.shape[1] - np.trace(total)
    variance = np.trace(total) - 2 * np.einsum("fij,fji->", square, shares) + np.einsum("ij,ji->", total, total)
    return float(mean), float(mean**2 / variance) if mean > 0 and variance > 0 else 0.0
