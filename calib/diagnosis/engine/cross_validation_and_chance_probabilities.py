"""Cross-validation of a selection, and probabilities of chance.

How probable it is that chance alone explains a score.

Where a candidate was searched over a nonlinear parameter that means nothing under the null, its greatest delta
chi-square is not chi-square: Davies' bound is used (Biometrika 74, 1987, 33-43, eq. 3.4), the search's own variation
standing for the expected upcrossings. Over candidates the bound is Bonferroni's. The dispersion is the sandwich's
(White, Econometrica 48, 1980, 817-838), as the mean of its eigenvalues (Rao and Scott, JASA 76, 1981, 221-230), as firm
as the frames that it is told by (Bell and McCaffrey, Survey Methodology 28, 2002, 169-181).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaln

from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import SWALLOWED, FrameProducts
from calib.diagnosis.engine.linear_residual_model import LinearModel
from calib.identify.bounded_and_robust_least_squares_fit import time_block_folds
from rig.array_and_json_types import Booleans, Floats, Integers

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


def scan_p_value(delta_chi2: Floats, rank: float, degrees_of_freedom: float) -> float:
    """p-value of the greatest delta chi-square (k,) of a scan, with `rank` linear parameters each.

    Scanned in order; Fisher's F stands for chi-square where the degrees of freedom of what they were divided by are
    few.
    """
    top = max(float(delta_chi2.max()), 1e-12)
    rank = max(int(rank), 1)
    tail = (
        scipy.special.fdtrc(rank, max(degrees_of_freedom, 1.0), top / rank)
        if degrees_of_freedom < MANY
        else scipy.special.chdtrc(rank, top)
    )
    if len(delta_chi2) == 1:
        return float(tail)
    variation = np.abs(np.diff(np.sqrt(np.maximum(delta_chi2, 0)))).sum()
    half = rank / 2
    log_bound = np.log(max(variation, 1e-12)) + (half - 0.5) * np.log(top) - top / 2 - half * np.log(2) - gammaln(half)
    heavier = tail / max(
        scipy.special.chdtrc(rank, top), 1e-300
    )  # what few frames add to the tail, added to the bound as well
    return float(min(1.0, tail + np.exp(min(log_bound, 0)) * min(max(heavier, 1.0), 1e6)))


def residual_dispersion(
    model: LinearModel, products: FrameProducts, weights: Floats, coefficients: Floats, correlated_frames: int = 1
) -> Dispersion:
    """Dispersion of the residuals about a candidate of weights (F, a, q) and coefficients (q,).

    correlated_frames : frames in a row that are taken together
    """
    F, a, q = weights.shape
    pushed = products.gamma * weights if a == 1 else products.gamma @ weights
    rows = weights.reshape(F * a, q)
    K = products.onto(rows.T @ products.kappa.reshape(F * a, -1))
    reach = K.T @ coefficients
    half = _seen(rows.T @ pushed.reshape(F * a, q), K)
    rank = half.shape[1]
    if not rank:
        return Dispersion(1.0, 1.0)
    # from here on in orthonormal combinations of the directions
    onto, seen = half.T @ K, (rows @ half).reshape(F, a, rank)
    along = products.kappa.reshape(F * a, -1) @ products.of_columns(np.column_stack([reach, onto.T]))
    along_reach, along = along[:, 0].reshape(F, a), along[:, 1:].reshape(F, a, rank)
    own = products.beta - pushed @ coefficients + along_reach  # products with what the fit leaves
    leakage, carried = model.leakage_and_carried(reach, onto)
    moved = np.einsum("fa,far->fr", weights @ coefficients, along)
    contributions = np.einsum("far,fa->fr", seen, own) - leakage + moved
    freed = (pushed.reshape(F * a, q) @ half).reshape(F, a, rank) - along
    left, right = np.concatenate([seen, -along], axis=1), np.concatenate([freed, seen], axis=1)

    def shares(together: int) -> Floats:
        """(groups, r, r) of the directions, nuisances taken out, of so many frames together."""
        count = -(-F // together), together * left.shape[1], rank
        a, b = np.zeros(count).reshape(-1, rank), np.zeros(count).reshape(-1, rank)
        a[: F * left.shape[1]], b[: F * left.shape[1]] = left.reshape(-1, rank), right.reshape(-1, rank)
        rest = np.add.reduceat(carried, np.arange(0, F, together), axis=0)
        return np.asarray(np.swapaxes(a.reshape(count), 1, 2) @ b.reshape(count) + rest)

    together = correlated_frames
    expected, freedom = _expected(shares(together))
    if together > 1 and freedom < FEW:
        together = 1
        expected, freedom = _expected(shares(together))
    contributions = np.add.reduceat(contributions, np.arange(0, F, together), axis=0)
    if expected < SWALLOWED * rank:  # one frame shows it all, and nothing of how frames differ
        return Dispersion(1.0, 1.0)
    ratio = float((contributions**2).sum()) / expected
    return Dispersion(max(1.0, ratio), max(1.0, freedom))


def _seen(before: Floats, K: Floats) -> Floats:
    """(q, r) combinations of a candidate's directions that are orthonormal, nuisances taken out, of those that these
    leave visible.
    before : (q, q) products of the directions with nuisances in; K : (q, p) with the nuisances' orthonormal basis"""
    scale = np.sqrt(np.maximum(np.diag(before), 1e-300))
    values, vectors = np.linalg.eigh((before - K @ K.T) / scale[:, None] / scale)
    retained = values > SWALLOWED
    return vectors[:, retained] / np.sqrt(values[retained]) / scale[:, None]


def _expected(shares: Floats) -> tuple[float, float]:
    """(mean, degrees of freedom by Satterthwaite) of contributions squared whose covariances are as stated, the
    candidate fitted: r - r / F and r (F - 1) where F frames say as much of r directions each; less of both where a few
    frames say most.
    shares : (F, r, r) that frames have in what is known of the directions"""
    stacked = shares.reshape(-1, shares.shape[1])  # each is symmetric
    total = stacked.T @ stacked
    mean = shares.shape[1] - np.trace(total)
    cubes = float(np.vdot(shares @ shares, shares))
    variance = np.trace(total) - 2 * cubes + np.einsum("ij,ji->", total, total)
    return float(mean), float(mean**2 / variance) if mean > 0 and variance > 0 else 0.0


FOLDS = 5
STRETCHES = 30  # over which a gain is judged
FEWEST = 4  # frames of a stretch
SHORTER = 4  # stretches in place of one, where something happens at one time
RIDGE = 1e-9  # keeps directions that a training set cannot see where they stood
FIRM = 1e-10  # of an information's diagonal, added so that a training set can always be solved for


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Held-out misfit (RMS, in unit) without a term and with it, and what noise alone leaves; unit "m" or "px".

    gain : by which the whitened sum of squares falls on held-out frames, in standard errors over stretches of frames
    """

    before: float
    after: float
    floor: float
    unit: str
    gain: float


class HeldOut(NamedTuple):
    """Residuals by a fit to other frames. frames : for each block (m,), the rows of frames alone; beforehand : for each
    block, the rest.
    """

    frames: tuple[Floats, ...]
    beforehand: tuple[Floats, ...]


def time_stretch_folds(count: int, folds: int) -> Integers:
    """Folds (count,) of frames by stretches of time.

    Whole stretches in time.

    No stretch is too short for a fold of its own.
    """
    return time_block_folds(count, min(folds, max(count // FEWEST, 2)))


def cross_validation_folds_of_frames(frames: int, has_sudden_effects: bool, sides: Sequence[Booleans] = ()) -> Integers:
    """Cross-validation folds (F,) of frames.

    Stretches of time, which with sudden effects are spread over both sides.
    sides : each (F,) bool, what is
    before such a moment or after it; of one that is within a single stretch, the later half is held out with the
    next.
    """
    count = min(FOLDS, frames // FEWEST)
    if not has_sudden_effects:
        return time_block_folds(frames, count)
    fold = time_block_folds(frames, min(SHORTER * FOLDS, frames // FEWEST)) % count
    for own in map(np.flatnonzero, sides):
        if len(own) > 1 and len(np.unique(fold[own])) == 1:
            fold[own[len(own) // 2 :]] = (fold[own[0]] + 1) % count
    return fold


def held_out_residuals(
    model: LinearModel, residuals: tuple[Floats, ...], fold: Integers, single_fold: int | None = None
) -> HeldOut:
    """Held-out residuals (HeldOut) of each fold.

    They have the nuisances fitted on the other folds.
    residuals : one (m,) for each block, as they are with the nuisances at the model's values
    model : with an explicit basis, else ValueError is raised; what was known beforehand is known in every fold, and is
        judged by the fit to all
    single_fold : the one fold to hold out, the others' rows staying as they are; None for each in turn
    """
    if model.half is not None:
        raise ValueError("only a model whose nuisances' basis is explicit can hold frames out")
    basis, known = model.columns.whole, [block.known_rows for block in model.blocks]
    held = sum(Q[at].T @ Q[at] for Q, at in zip(basis, known)) + RIDGE * np.eye(model.columns.count)
    pulled = sum(Q[at].T @ y[at] for Q, y, at in zip(basis, residuals, known))
    rights = {h: model.right(fold == h, residuals) for h in np.unique(fold).tolist()}
    grams = {h: model.gram(fold == h) for h in rights if h != single_fold}
    everything = sum(rights.values()) + pulled
    out = [y[block.frames_rows].copy() for block, y in zip(model.blocks, residuals)]
    for hold in rights if single_fold is None else [single_fold]:
        size = np.linalg.solve(
            sum(gram for h, gram in grams.items() if h != hold) + held,
            sum(right for h, right in rights.items() if h != hold) + pulled,
        )
        for left, Q, block in zip(out, basis, model.blocks):
            for rows in block.rows_of(fold == hold):
                left[rows] -= Q[rows] @ size
    return HeldOut(tuple(out), tuple(y[at] - Q[at] @ everything for Q, y, at in zip(basis, residuals, known)))


def make_refit_without_columns(
    grams: Sequence[Floats], rights: Sequence[Floats], information: Floats
) -> Callable[[Integers], list[Floats]]:
    """Make a function that refits each fold without some columns (indices).

    It gives the fitted sizes (p,) of all.
    grams, rights : for each fold, (p, p) its whitened columns' products with each other and (p,) with the residual
    information : (p, p) of all folds, priors included
    """
    p, inverses = len(information), []
    for gram in grams:
        H = information - gram
        H[np.diag_indices_from(H)] *= 1 + FIRM
        inverses.append(cho_solve(cho_factor(H), np.eye(p)))
    whole = [P @ (sum(rights) - right) for P, right in zip(inverses, rights)]

    def sizes(gone: Integers) -> list[Floats]:
        return [
            size - P[:, gone] @ np.linalg.solve(P[np.ix_(gone, gone)], size[gone]) for P, size in zip(inverses, whole)
        ]

    return sizes


def signed_rank_gain_in_standard_errors(square_reductions: Floats) -> float:
    """Gain of held-out stretches in standard errors, by Wilcoxon's signed ranks of square reductions (n,)."""
    by = np.bincount(time_stretch_folds(len(square_reductions), STRETCHES), weights=square_reductions)
    by = by[by != 0]
    if by.sum() <= 0:
        return 0.0
    n = len(by)
    _, at, alike = np.unique(np.abs(by), return_inverse=True, return_counts=True)
    ranks = (np.cumsum(alike) - (alike - 1) / 2)[at]
    return float(ranks @ np.sign(by) / np.sqrt(n * (n + 1) * (2 * n + 1) / 6))


def summed_gain_in_standard_errors(square_reductions: Floats, prior_reduction: float = 0.0) -> float:
    """Gain of held-out stretches in standard errors, by the sum of square reductions (n,).

    prior_reduction : what squares fall by that belong to no frame: a misfit that the prior on a nuisance alone shows
        is no stretch's, and has no rank
    """
    by = np.bincount(
        time_block_folds(len(square_reductions), min(20, len(square_reductions) // 2)), weights=square_reductions
    )
    error = np.sqrt(len(by)) * by.std(ddof=1) if len(by) > 1 else np.inf
    return float((by.sum() + prior_reduction) / max(error, 1e-300))
