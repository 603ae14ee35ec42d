"""Cross-validation of terms: folds of whole stretches of time, held-out residuals, and the gain by a term."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calib.diagnosis.engine.linear_model import LinearModel
from calib.samples.pose_samples import time_block_folds
from rig.array_types import Booleans, Floats, Integers

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
    """(count,) fold of each frame: whole stretches in time, never too short to tell anything."""
    return time_block_folds(count, min(folds, max(count // FEWEST, 2)))


def frame_folds(frames: int, has_sudden_effects: bool, sides: Sequence[Booleans] = ()) -> Integers:
    """(F,) fold of each frame: a stretch of time; with sudden effects, several stretches spread over both sides.
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
    """HeldOut of residuals (one (m,) for each block, as they are with the nuisances at the model's values): nuisances
    fitted on other folds.

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
    """Make a function that refits each fold without some columns (indices): the fitted sizes (p,) of all.

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

    prior_reduction : what squares fall by that belong to no frame: a misfit that the prior on a nuisance alone shows is no
        stretch's, and has no rank
    """
    by = np.bincount(
        time_block_folds(len(square_reductions), min(20, len(square_reductions) // 2)), weights=square_reductions
    )
    error = np.sqrt(len(by)) * by.std(ddof=1) if len(by) > 1 else np.inf
    return float((by.sum() + prior_reduction) / max(error, 1e-300))
