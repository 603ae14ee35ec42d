"""An arm's poses -> whitened residuals with calibration's freedoms and admitted terms taken out, ready to be searched joint by joint.

A term moves one joint's angle (or, for what moves the whole arm, the target's pose) by a few columns, each of unknown size; sizes
have loose normal priors, so that what the data cannot see stays near nothing. Scatter beyond the instrument's own is estimated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from calib.diagnose.engine.candidates import Node
from calib.diagnose.engine.linear import Block, Column, LinearModel
from calib.diagnose.engine.score import Score
from calib.diagnose.problems.arm.candidates import JointCandidate
from calib.diagnose.problems.arm.poses import Arms

ROUNDS = 6  # of weighing anew
SETTLED = 1e-3  # share by which the scatter may still change
GATE = 6.0  # standard deviations beyond which a pose is left out
LOOSE = 1e-12  # share of a freedom's information that stands for no prior at all


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """An admitted hypothesis. candidate; node : of its grid; weights : (n, a, q) per unit, see JointCandidate; prior : (q,) sizes"""

    candidate: JointCandidate
    node: Node
    weights: np.ndarray
    prior: np.ndarray

    @staticmethod
    def at(candidate: JointCandidate, node: Node) -> "Term":
        """Term of a candidate at a node."""
        return Term(candidate, node, candidate.weights(node), candidate.prior(node))

    @staticmethod
    def of(score: Score) -> "Term":
        """Term of a Score, at its node."""
        return Term.at(score.candidate, score.node)

    @property
    def only(self) -> JointCandidate:
        """The candidate, confined to this node."""
        return replace(self.candidate, grid=[self.node], step=0.0)

    def columns(self, arms: Arms) -> np.ndarray:
        """(n, k, q) change of what is measured, m and rad per unit of each coefficient."""
        return arms.directions(self.candidate.joint) @ self.weights


@dataclass(frozen=True, eq=False)
class Fit:
    """Freedoms and terms at their best on the poses `used` (n,) bool, weighted by W (n, k, k).

    X : (n, k, p + c) whitened columns; half : (p + c, p + c) upper triangular, half.T half = information with priors; theta : the sizes
    left : (n, k) residual, m and rad, of all poses; y : (n, k) the same whitened; scatter : (k,) beyond the instrument's own
    terms : the admitted; slices : where each one's sizes are in theta
    """

    arms: Arms
    terms: tuple[Term, ...]
    used: np.ndarray
    W: np.ndarray
    X: np.ndarray
    half: np.ndarray
    theta: np.ndarray
    left: np.ndarray
    y: np.ndarray
    scatter: np.ndarray
    slices: tuple[slice, ...]

    @property
    def size(self) -> int:
        """How many independent numbers there are."""
        return int(self.used.sum()) * self.y.shape[1] - self.arms.freedoms.shape[2]

    @cached_property
    def linear(self) -> LinearModel:
        """LinearModel of the poses used: one block, freedoms and terms as the nuisances' columns, priors in their half."""
        m, k = int(self.used.sum()), self.y.shape[1]
        block = Block("poses", "m", self.y[self.used].ravel(), np.arange(m + 1) * k)
        return LinearModel((block,), Column((self.X[self.used].reshape(m * k, -1),)), self.inverse, self.size)

    @cached_property
    def information(self) -> np.ndarray:
        """(p + c, p + c), priors included."""
        return self.half.T @ self.half

    @cached_property
    def inverse(self) -> np.ndarray:
        """(p + c, p + c) upper triangular R, R R.T the covariance of the sizes."""
        return solve_triangular(self.half, np.eye(len(self.half)), lower=False, check_finite=False)

    def covariance(self, number: int) -> np.ndarray:
        """(c, c) of one term's sizes."""
        part = self.inverse[self.slices[number]]
        return part @ part.T

    def known(self) -> float:
        """How many numbers of the terms the data determine, priors aside."""
        prior = self.prior()
        return float((prior > 0).sum() - prior @ (self.inverse ** 2).sum(axis=1))

    def prior(self) -> np.ndarray:
        """(p + c,) inverse squares of the sizes that priors expect, 0 for the freedoms."""
        return np.concatenate([np.zeros(self.arms.freedoms.shape[2])] + [1 / term.prior**2 for term in self.terms])

    def cost(self) -> float:
        """Whitened squares and the priors' part: what a term's delta chi-square is a fall of."""
        return float((self.y[self.used] ** 2).sum() + self.prior() @ self.theta**2)

    def without_terms(self, numbers: Sequence[int]) -> "Fit":
        """The Fit of the other terms with weights and poses as they are: rows and columns of the information struck out."""
        keep = np.ones(self.X.shape[2], bool)
        for number in numbers:
            keep[self.slices[number]] = False
        terms = tuple(term for i, term in enumerate(self.terms) if i not in numbers)
        return self._solved(terms, self.X[..., keep], self.information[np.ix_(keep, keep)])

    def with_terms(self, terms: Sequence[Term]) -> "Fit":
        """The Fit with more terms, weights and poses as they are."""
        more = np.concatenate([self.W @ term.columns(self.arms) for term in terms], axis=2)
        flat, old = more[self.used].reshape(-1, more.shape[2]), self.X[self.used].reshape(-1, self.X.shape[2])
        cross, own = old.T @ flat, flat.T @ flat
        own[np.diag_indices_from(own)] += np.concatenate([1 / term.prior**2 for term in terms]) + LOOSE * np.diag(own) + 1e-300
        H = np.block([[self.information, cross], [cross.T, own]])
        return self._solved((*self.terms, *terms), np.concatenate([self.X, more], axis=2), H)

    def _solved(self, terms: tuple[Term, ...], X: np.ndarray, H: np.ndarray) -> "Fit":
        target = (self.W @ self.arms.left[..., None])[..., 0]
        factor = cho_factor(H)
        theta = cho_solve(factor, X[self.used].reshape(-1, X.shape[2]).T @ target[self.used].ravel())
        y = target - X @ theta
        return replace(self, terms=terms, X=X, half=np.triu(factor[0]), theta=theta, left=np.linalg.solve(self.W, y[..., None])[..., 0], y=y,
                       slices=_slices(self.arms, terms))

    def criterion(self) -> float:
        """Bayesian information criterion with its weights as they are."""
        return self.cost() + (self.known() + sum(one.candidate.extra for one in self.terms)) * np.log(self.size)

    def part(self, number: int) -> np.ndarray:
        """(n,) rad by which a term turns its joint in every pose, or m by which it moves the tool where it acts on the whole arm."""
        moved = self.terms[number].weights @ self.theta[self.slices[number]]
        return moved[:, 0] if self.terms[number].candidate.joint is not None else np.linalg.norm(moved[:, :3], axis=1)


def fit(arms: Arms, terms: Sequence[Term] = (), train: np.ndarray | None = None, scatter: np.ndarray | None = None,
        rounds: int = ROUNDS) -> Fit:
    """Fit of terms on the poses of a mask train (n,), all by default; scatter : (k,) where it starts; rounds : of weighing anew."""
    train = np.ones(len(arms), bool) if train is None else train
    parts = [arms.freedoms] + [term.columns(arms) for term in terms]
    raw = np.concatenate(parts, axis=2)
    free = arms.freedoms.shape[2]
    prior = np.concatenate([np.zeros(free)] + [1 / term.prior**2 for term in terms])
    used, k = train.copy(), arms.left.shape[1]
    scatter = _scatter(arms.left[used], arms.own[used]) if scatter is None else scatter
    for _ in range(rounds):
        W = np.linalg.inv(np.linalg.cholesky(arms.own + np.diag(scatter**2)))
        X = W @ raw
        flat = X[used].reshape(-1, X.shape[2])
        H = flat.T @ flat
        H[np.diag_indices_from(H)] += prior + LOOSE * np.diag(H) + 1e-300
        factor = cho_factor(H)
        theta = cho_solve(factor, flat.T @ (W[used] @ arms.left[used][..., None]).ravel())
        left = arms.left - raw @ theta
        inverse = solve_triangular(factor[0], np.eye(len(H)), lower=False, check_finite=False)
        taken = len(H) - (prior * (inverse**2).sum(axis=1)).sum()
        new = _scatter(left[used], arms.own[used], min(taken / flat.shape[0], 0.8))
        sigma = np.sqrt(np.einsum("nkk->nk", arms.own) + new**2)
        good = train & (np.abs(left) < GATE * sigma).all(axis=1)
        if (good == used).all() and np.allclose(new, scatter, rtol=SETTLED, atol=1e-9):
            break
        used, scatter = good, new
    y = (W @ left[..., None]).reshape(-1, k)
    return Fit(arms, tuple(terms), used, W, X, np.triu(factor[0]), theta, left, y, scatter, _slices(arms, terms))


def _slices(arms: Arms, terms: Sequence[Term]) -> tuple[slice, ...]:
    edges = np.cumsum([arms.freedoms.shape[2], *(len(term.prior) for term in terms)])
    return tuple(slice(a, b) for a, b in zip(edges[:-1], edges[1:]))


def _scatter(left: np.ndarray, own: np.ndarray, share: float = 0.0) -> np.ndarray:
    """(k,) scatter beyond the instrument's, one figure for positions, one for rotations; share : of the numbers that were fitted."""
    out = np.zeros(left.shape[1])
    for part in (slice(0, 3), slice(3, 6)):
        if left[:, part].size:
            seen, stated = (left[:, part] ** 2).mean() / (1 - share), np.einsum("nkk->nk", own)[:, part].mean()
            if seen > stated * (1 + 3 * np.sqrt(2 / left[:, part].size)):
                out[part] = np.sqrt(seen - stated)
    return out
