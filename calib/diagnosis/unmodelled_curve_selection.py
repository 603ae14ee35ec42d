"""Selection of smooth curves for what has no name at an axis: which covariate, how large, and whether it holds.

Of every candidate the marginal likelihood of a normal prior on its coefficients says how large and how fine it is
(Rasmussen and Williams, Gaussian processes for machine learning, 2006, ch. 5). Whether it holds is asked of stretches
of the recording held out whole, for which the candidate, its size and its coefficients are chosen anew without them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calib.diagnosis.engine.cross_validation_and_chance import RIDGE, frame_folds, summed_gain_in_standard_errors
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect import Candidate, Effect

SIZES = np.geomspace(1e-7, 1e-2, 26)  # prior standard deviations of a curve, in the axis' unit
TRANSIENT = 3.0  # log of how much likelier a curve over time, which may not come again, must be than another
LIKELIER = 5.0  # log of how much likelier a curve must be than none
GAIN = 2.0  # standard errors by which held-out stretches must gain


@dataclass(frozen=True, slots=True, eq=False)
class AxisRows:
    """What a recording says of an axis, whitened. residual : (m,); nuisances : (m, p); frame : (m,) of each row
    gram, right : of some frames (F,) bool, (p, p) and (p,) of the nuisances over all that was measured; known : the
    same of what was known beforehand; in_units : whitened rows (m,) -> (F,) in m or rad; noise : RMS of what measuring
    adds
    """

    residual: Floats
    nuisances: Floats
    frame: Integers
    gram: Callable[[Floats], Floats]
    right: Callable[[Floats], Floats]
    known: tuple[Floats, Floats]
    in_units: Callable[[Floats], Floats]
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class ChosenCurve:
    """effect : the curve with its size and coefficients; before, after : RMS on held-out poses without it and with it,
    what noise adds taken off; gain : standard errors by which these gain
    """

    effect: Effect
    before: float
    after: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class _Training:
    """Normal equations of all candidates' columns, the nuisances eliminated: G (Q, Q), b (Q,); onto : (p, Q) of the
    nuisances, solved for; at : (p,) nuisances alone
    """

    G: Floats
    b: Floats
    onto: Floats
    at: Floats


def choose_curve(
    rows: AxisRows, candidates: Sequence[Candidate], columns: Sequence[Floats], frames: int
) -> ChosenCurve | None:
    """The curve that explains an axis' residual best, None where none holds on held-out stretches.

    columns : one (m, q) for each candidate, whitened, per unit of its coefficients at size 1
    """
    fold, edges = frame_folds(frames, True), np.r_[0, np.cumsum([part.shape[1] for part in columns])]
    parts, C = [slice(a, b) for a, b in zip(edges[:-1], edges[1:])], np.concatenate(columns, axis=1)
    folds = [_products(rows, C, fold == h) for h in np.unique(fold)]
    before, after = rows.residual.copy(), rows.residual.copy()
    for h in np.unique(fold):
        trained = _trained(rows, [part for k, part in zip(np.unique(fold), folds) if k != h])
        number, size, _ = _best(trained, candidates, parts)
        theta = _coefficients(trained, parts[number], size)
        held = fold[rows.frame] == h
        nuisances = trained.at - trained.onto[:, parts[number]] @ theta
        before[held] -= rows.nuisances[held] @ trained.at
        after[held] -= rows.nuisances[held] @ nuisances + C[held, parts[number]] @ theta
    fall = np.zeros(frames)
    np.add.at(fall, rows.frame, before**2 - after**2)
    gain = summed_gain_in_standard_errors(fall)
    trained = _trained(rows, folds)
    number, size, likelier = _best(trained, candidates, parts)
    if gain < GAIN or likelier < LIKELIER:
        return None
    theta = _coefficients(trained, parts[number], size) / size
    chosen = candidates[number]
    effect = chosen.effect({**chosen.grid[0], "size": float(size)}, np.asarray(theta))
    squares = [float(np.mean(rows.in_units(part) ** 2)) - rows.noise**2 for part in (before, after)]
    return ChosenCurve(effect, math.sqrt(max(squares[0], 0.0)), math.sqrt(max(squares[1], 0.0)), gain)


def _products(rows: AxisRows, C: Floats, some: Floats) -> tuple[Floats, ...]:
    """Of some frames (F,) bool: products of nuisances (p, p) and (p,), of columns with nuisances (p, Q), with each
    other (Q, Q) and with the residual (Q,).
    """
    own = some[rows.frame]
    part = C[own]
    return rows.gram(some), rows.right(some), rows.nuisances[own].T @ part, part.T @ part, part.T @ rows.residual[own]


def _trained(rows: AxisRows, folds: Sequence[tuple[Floats, ...]]) -> _Training:
    gram, right, cross, square, with_residual = (np.sum(parts, axis=0) for parts in zip(*folds))
    gram = gram + rows.known[0] + RIDGE * np.eye(len(gram))
    factor = cho_factor(gram)
    onto, at = cho_solve(factor, cross), cho_solve(factor, right + rows.known[1])
    return _Training(square - cross.T @ onto, with_residual - cross.T @ at, onto, at)


def _best(trained: _Training, candidates: Sequence[Candidate], parts: Sequence[slice]) -> tuple[int, float, float]:
    """(number of the candidate, size, log of how much likelier than none), the choice among its kind allowed for."""
    found = []
    for candidate, part in zip(candidates, parts):
        values, vectors = np.linalg.eigh(trained.G[part, part])
        values, z = np.maximum(values, 0.0), vectors.T @ trained.b[part]
        gained = 0.5 * (z**2 / (SIZES[:, None] ** -2.0 + values) - np.log1p(SIZES[:, None] ** 2 * values)).sum(axis=1)
        alike = sum(other.kind is candidate.kind for other in candidates)
        rarer = TRANSIENT if candidate.kind.sudden else 0.0
        found.append((float(gained.max()) - math.log(alike) - rarer, float(SIZES[gained.argmax()])))
    number = int(np.argmax([likelier for likelier, _ in found]))
    return number, found[number][1], found[number][0]


def _coefficients(trained: _Training, part: slice, size: float) -> Floats:
    """(q,) of one candidate, per unit of its columns."""
    count = part.stop - part.start
    return cast(Floats, np.linalg.solve(trained.G[part, part] + np.eye(count) / size**2, trained.b[part]))
