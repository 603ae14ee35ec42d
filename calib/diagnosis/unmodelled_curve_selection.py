"""Selection of smooth curves for what has no name at an axis: which covariate, how large, and whether it holds.

Of every candidate the marginal likelihood of a normal prior on its coefficients says how large and how fine it is
(Rasmussen and Williams, Gaussian processes for machine learning, 2006, ch. 5). Whether it holds is asked of stretches
of the recording held out whole, for which the candidate, its size and its coefficients are chosen anew without them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calib.diagnosis.engine.cross_validation_and_chance import RIDGE, frame_folds, signed_rank_gain_in_standard_errors
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect import Candidate, Effect

SIZES = np.geomspace(1e-7, 1e-2, 26)  # prior standard deviations of a curve, in the axis' unit
TRANSIENT = 3.0  # log of how much likelier a curve over time, which may not come again, must be than another
LIKELIER = 5.0  # log of how much likelier a curve must be than none
SCATTERS = (0.03, 0.1, 0.3, 1.0)  # shares of an axis' scatter without a curve, that it may have beside one
GAIN = 2.0  # standard errors by which held-out stretches must gain


@dataclass(frozen=True, slots=True, eq=False)
class AxisRows:
    """What a recording says of an axis, whitened by a scatter that the axis may have. residual : (m,)
    nuisances : (m, p); frame : (m,) of each row; columns : of each candidate (m, q) per unit of its coefficients
    gram, right : of some frames (F,) bool, (p, p) and (p,) of the nuisances over all that was measured; known : the
    same of what was known beforehand; level : (F,) log of each frame's whitening; in_units : whitened rows (m,) ->
    (F,) in m or rad; noise : RMS of what measuring adds
    """

    residual: Floats
    nuisances: Floats
    frame: Integers
    columns: Sequence[Floats]
    gram: Callable[[Floats], Floats]
    right: Callable[[Floats], Floats]
    known: tuple[Floats, Floats]
    level: Floats
    in_units: Callable[[Floats], Floats]
    noise: float

    @property
    def parts(self) -> list[slice]:
        """Where each candidate's columns are among all."""
        edges = np.r_[0, np.cumsum([part.shape[1] for part in self.columns])].tolist()
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]


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
    nuisances, solved for; at : (p,) nuisances alone; likelihood : its logarithm without a curve, but for a constant
    """

    G: Floats
    b: Floats
    onto: Floats
    at: Floats
    likelihood: float


class _Choice(NamedTuple):
    """view : index of the scatter; number : of the candidate; size; likelier : log of how much likelier than none;
    theta : (q,) coefficients; nuisances : (p,) with them; bare : (p,) without.
    """

    view: int
    number: int
    size: float
    likelier: float
    theta: Floats
    nuisances: Floats
    bare: Floats


def choose_curve(views: Sequence[AxisRows], candidates: Sequence[Candidate]) -> ChosenCurve | None:
    """The curve that explains an axis' residual best, None where none holds on held-out stretches.

    views : the same by scatters that the axis may have, which is chosen with the curve
    """
    frames = len(views[0].level)
    fold = frame_folds(frames, True)
    C = [np.concatenate(rows.columns, axis=1) for rows in views]
    folds = [[_products(rows, columns, fold == h) for h in np.unique(fold)] for rows, columns in zip(views, C)]
    before, after = np.zeros(frames), np.zeros(frames)
    for h in np.unique(fold).tolist():
        found = _best(views, candidates, [[part for k, part in enumerate(each) if k != h] for each in folds])
        rows, held = views[found.view], fold == h
        bare = rows.residual - rows.nuisances @ found.bare
        with_curve = rows.residual - rows.nuisances @ found.nuisances - rows.columns[found.number] @ found.theta
        before[held], after[held] = rows.in_units(bare)[held], rows.in_units(with_curve)[held]
    gain = signed_rank_gain_in_standard_errors(before**2 - after**2)
    found = _best(views, candidates, folds)
    if gain < GAIN or found.likelier < LIKELIER:
        return None
    chosen = candidates[found.number]
    effect = chosen.effect({**chosen.grid[0], "size": found.size}, found.theta / found.size)
    squares = [float(np.mean(part**2)) - views[0].noise ** 2 for part in (before, after)]
    return ChosenCurve(effect, math.sqrt(max(squares[0], 0.0)), math.sqrt(max(squares[1], 0.0)), gain)


def _products(rows: AxisRows, C: Floats, some: Floats) -> tuple[Floats | float, ...]:
    """Of some frames (F,) bool: products of nuisances (p, p) and (p,), of columns C (m, Q) with nuisances (p, Q), with
    each other (Q, Q) and with the residual (Q,); log likelihood of the residual.
    """
    own = some[rows.frame]
    part, left = C[own], rows.residual[own]
    likelihood = float(rows.level[some].sum() - left @ left / 2)
    return rows.gram(some), rows.right(some), rows.nuisances[own].T @ part, part.T @ part, part.T @ left, likelihood


def _trained(rows: AxisRows, folds: Sequence[tuple[Floats | float, ...]]) -> _Training:
    gram, right, cross, square, with_residual, likelihood = (np.sum(parts, axis=0) for parts in zip(*folds))
    gram, right = gram + rows.known[0] + RIDGE * np.eye(len(gram)), right + rows.known[1]
    factor = cho_factor(gram)
    onto, at = cho_solve(factor, cross), cho_solve(factor, right)
    likelihood = float(likelihood + right @ at / 2 - np.log(np.diag(factor[0])).sum())
    return _Training(square - cross.T @ onto, with_residual - cross.T @ at, onto, at, likelihood)


def _best(
    views: Sequence[AxisRows], candidates: Sequence[Candidate], folds: Sequence[Sequence[tuple[Floats | float, ...]]]
) -> _Choice:
    """The _Choice by some folds of each view, the choice among the candidates of a kind allowed for."""
    trained = [_trained(rows, each) for rows, each in zip(views, folds)]
    parts, found = views[0].parts, []
    for view, one in enumerate(trained):
        for number, (candidate, part) in enumerate(zip(candidates, parts)):
            values, vectors = np.linalg.eigh(one.G[part, part])
            values, z = np.maximum(values, 0.0), vectors.T @ one.b[part]
            gained = (z**2 / (SIZES[:, None] ** -2.0 + values) - np.log1p(SIZES[:, None] ** 2 * values)).sum(axis=1) / 2
            alike = sum(other.kind is candidate.kind for other in candidates)
            rarer = TRANSIENT if candidate.kind.sudden else 0.0
            score = one.likelihood + float(gained.max()) - math.log(alike) - rarer
            found.append((score, view, number, float(SIZES[gained.argmax()])))
    score, view, number, size = max(found)
    one, part = trained[view], parts[number]
    information = one.G[part, part] + np.eye(part.stop - part.start) / size**2
    theta = cast(Floats, np.linalg.solve(information, one.b[part]))
    likelier = score - max(other.likelihood for other in trained)
    return _Choice(view, number, size, likelier, theta, one.at - one.onto[:, part] @ theta, one.at)
