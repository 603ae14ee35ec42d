"""How far printed markers are off beyond chance, told by the recording itself: variance components of an adjustment, by restricted likelihood.

Source: Harville, Maximum likelihood approaches to variance component estimation, JASA 72, 1977; fixed point: MacKay, Neural Computation 4, 1992
"""

from dataclasses import dataclass, replace

import numpy as np

from vision.bundle.adjust import Adjustment, adjust
from vision.bundle.normal import linearise, normal_equations, reduce
from vision.bundle.motions import offset
from vision.bundle.printing import KINDS, NAMES, Printing
from vision.bundle.robust import Sorted, within_gate
from vision.bundle.unknowns import unknowns
from vision.observations import Observations, only, whitener

MOST = 2.0  # of what is tolerated; markers farther off than that were not printed so, they were put elsewhere
TRIAL = Printing(1.0, 1.0, 1.0, 1.0)
PROOF = 12.1  # by which twice the log likelihood has to rise: one degree of freedom, a chance of 1 in 2000, and half the time nothing rises at all
FEWEST = 16  # markers, from which a variance is told to a third of itself
ROUNDS, SETTLED = 200, 1e-3  # of the fixed point; relative change of a standard deviation at which it ends
LEAST = 1e-3  # of what is tolerated, below which there is nothing


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """What images say of prints, all else free. information : (q, q), right : (q,) in units of what is tolerated; kind : (q,) which variance each
    has; cost, dof : of the adjustment without them."""

    information: np.ndarray
    right: np.ndarray
    kind: np.ndarray
    cost: float
    dof: float


def printed(observations: Observations, fit: Sorted, free: tuple[str, ...]) -> Sorted:
    """The Sorted of an adjustment with markers taken to be printed as the recording tells, or as it was where it tells nothing.

    observations : Observations of all frames; fit : Sorted of them, places of markers as stated
    """
    a = fit.adjustment
    kept = replace(only(observations, fit.solved), covariance=fit.covariance[np.isin(observations.frame, fit.solved)])
    good = fit.inliers[np.isin(observations.frame, fit.solved)]
    if len(np.unique(kept.marker[good])) < FEWEST:
        return fit
    printing = _printing(_told(kept.take(good), a, free))
    if printing is None:
        return fit
    for _ in range(2):  # what belongs to it is sorted out once more, by a scatter that is now the corners' own
        a = adjust(kept.take(good), replace(a.state, markers=a.stated.markers) if a.printing is None else a.state, free, stated=fit.adjustment.stated,
                   printing=printing)
        before, good = good, within_gate(kept, a.state)
        if (good == before).all():
            break
    scale = float(np.sqrt(a.cost / a.dof))
    inliers = fit.inliers.copy()
    inliers[np.isin(observations.frame, fit.solved)] = before
    return Sorted(a, fit.solved, inliers, scale**2 * fit.covariance, scale * fit.scale)


def _told(observations: Observations, a: Adjustment, free: tuple[str, ...]) -> _Told:
    u, estimate = unknowns(observations, a.state, a.stated, free, printing=TRIAL)
    residual, derivatives = linearise(observations, estimate, u, whitener(observations))
    away = offset(estimate, a.stated, u)
    _, reduced, right = reduce(normal_equations(observations, derivatives, residual, u, away))
    covariance = u.basis @ np.linalg.inv(u.basis.T @ reduced @ u.basis) @ u.basis.T
    columns = np.concatenate([np.arange(c.start, c.stop) for c in (*u.prints.rows.values(), u.prints.together)])
    inverse = np.linalg.inv(covariance[np.ix_(columns, columns)])
    kind = [k for k, part in enumerate(KINDS) for _ in range(len(NAMES))[part]]
    return _Told(inverse - np.eye(len(columns)), inverse @ (covariance @ right)[columns], np.array(kind * len(u.prints.rows) + [len(KINDS) - 1]),
                 float((residual**2).sum() + (u.prior * away**2).sum()), a.dof)


def _printing(told: _Told) -> Printing | None:
    """Printing with the variances that are there beyond chance, or None where none is."""
    there = np.ones(len(KINDS), bool)
    sigma, best = _likeliest(told, there)
    while there.any():
        without = {int(k): _likeliest(told, there & (np.arange(len(KINDS)) != k), sigma) for k in np.flatnonzero(there)}
        least = min(without, key=lambda k: without[k][1])
        if without[least][1] - best > PROOF:
            return Printing(*sigma.tolist())
        there[least] = False
        sigma, best = without[least]
    return None


def _likeliest(told: _Told, there: np.ndarray, start: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    """(standard deviations (kinds,) of those that are `there`, minus twice their restricted log likelihood but for a constant)."""
    sigma = np.where(there, 1.0 if start is None else start, 0.0)
    noise, q = told.cost / told.dof, len(told.right)
    for _ in range(ROUNDS):
        width = sigma[told.kind]
        M = noise * np.eye(q) + width[:, None] * told.information * width
        inverse = np.linalg.inv(M)
        x = width * (inverse @ (width * told.right))
        known = 1 - noise * np.diag(inverse)
        left = told.cost - 2 * told.right @ x + x @ told.information @ x
        new = sigma.copy()
        for k in np.flatnonzero(sigma > 0):
            own = told.kind == k
            new[k] = min(np.sqrt((x[own] ** 2).sum() / max(known[own].sum(), 1e-9)), MOST)
        new[new < LEAST] = 0.0
        noise, done = float(left / (told.dof - known.sum())), (np.abs(new - sigma) <= SETTLED * sigma).all()
        sigma = new
        if done:
            break
    width = sigma[told.kind]
    M = noise * np.eye(q) + width[:, None] * told.information * width
    z = width * told.right
    likelihood = np.linalg.slogdet(M / noise)[1] + told.dof * np.log(noise) + (told.cost - z @ np.linalg.solve(M, z)) / noise
    return sigma, float(likelihood)
