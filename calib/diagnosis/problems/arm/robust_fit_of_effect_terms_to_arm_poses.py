"""Robust fit of effect terms to an arm's poses.

Whitened residuals, with calibration's freedoms and admitted terms projected out.

A term moves one joint's angle (or, for what moves the whole arm, the target's pose) by a few columns, each of unknown
size; sizes have loose normal priors, so that what the data cannot see stays near nothing. Scatter beyond the
instrument's own is estimated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Node
from calib.diagnosis.engine.linear_residual_model import Block, Column, LinearModel
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    JointCandidate,
    JointScore,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import Arms, Columns, Part
from calib.identify.bounded_and_robust_least_squares_fit import excess_scatter, robust_weights
from rig.array_and_json_types import Booleans, Floats
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

ROUNDS = 6  # of weighing anew
SETTLED = 1e-3  # share by which the scatter may still change
SETTLED_TAIL = 0.02  # by which a pose's weight may
CHANGED = 0.1  # share of the scatter from which it is another
ASIDE = 0.2  # weight below which a pose agrees with no model
LOOSE = 1e-12  # share of a freedom's information that stands for no prior at all


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """scatter : (k,) m and rad beyond the instrument's own; tail : (n,) weight of each pose, below 1 where it is far
    off.
    """

    scatter: Floats
    tail: Floats

    def whitening(self, own: Floats) -> Floats:
        """(n, k, k) that makes residuals of the instrument's covariance (n, k, k) and the scatter white, and wild ones
        small.
        """
        return np.linalg.inv(np.linalg.cholesky(own + np.diag(self.scatter**2))) * np.sqrt(self.tail)[:, None, None]

    def like(self, other: "Weighing") -> bool:
        """Whether nothing has changed to speak of."""
        return (
            np.allclose(self.scatter, other.scatter, rtol=SETTLED, atol=1e-9)
            and np.abs(self.tail - other.tail).max() < SETTLED_TAIL
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Term(FieldSummaryRepr):
    """An admitted hypothesis. candidate; node : of its grid; weights : (n, a, q) per unit, see JointCandidate;
    prior : (q,) sizes
    level : m, scatter of positions when its node was last chosen, None for never"""

    candidate: JointCandidate
    node: Node
    weights: Floats
    prior: Floats
    level: float | None = None

    def stale(self, scatter: float) -> bool:
        """Whether its node was chosen at another scatter (m), or never."""
        return self.level is None or abs(scatter - self.level) > CHANGED * self.level

    @staticmethod
    def at(candidate: JointCandidate, node: Node) -> "Term":
        """Term of a candidate at a node."""
        return Term(candidate, node, candidate.weights(node), candidate.prior(node))

    @staticmethod
    def of(score: JointScore) -> "Term":
        """Term of a Score, at its node."""
        return Term.at(score.candidate, score.node)

    @property
    def only(self) -> JointCandidate:
        """The candidate, confined to this node."""
        return replace(self.candidate, grid=[self.node], step=0.0)

    @property
    def part(self) -> Part:
        """Its columns: the change of what is measured, per unit of each coefficient."""
        joint = self.candidate.joint
        return Part(joint, self.weights if joint is None else self.weights[:, 0])


@dataclass(frozen=True, eq=False, repr=False)
class Fit(FieldSummaryRepr):
    """Freedoms and terms at their best on the poses `used` (n,) bool, weighted by W (n, k, k).

    X : Columns (p + c) of the poses used, whitened; right : (p + c,) their products with what the geometry left;
        half : (p + c, p + c) upper
    triangular, half.T half = information with priors; theta : the sizes
    left : (n, k) residual, m and rad, of all poses; y : (n, k) the same whitened; weighing : Weighing
    terms : the admitted; slices : where each one's sizes are in theta
    """

    arms: Arms
    terms: tuple[Term, ...]
    used: Booleans
    W: Floats
    X: Columns
    right: Floats
    half: Floats
    theta: Floats
    left: Floats
    y: Floats
    weighing: Weighing
    slices: tuple[slice, ...]

    @property
    def scatter(self) -> Floats:
        """(k,) m and rad beyond the instrument's own."""
        return self.weighing.scatter

    @property
    def aside(self) -> Booleans:
        """(n,) bool, poses of those used that agree with no model and count for next to nothing."""
        return self.used & (self.weighing.tail < ASIDE)

    @property
    def size(self) -> int:
        """How many independent numbers there are."""
        return int(self.used.sum()) * self.y.shape[1] - self.arms.freedoms.shape[2]

    @cached_property
    def linear(self) -> LinearModel:
        """LinearModel of the poses used: one block, freedoms and terms as the nuisances' columns, priors in their
        half.
        """
        m, k = int(self.used.sum()), self.y.shape[1]
        block = Block("poses", self.arms.unit, self.y[self.used].ravel(), np.arange(m + 1) * k)
        return LinearModel((block,), Column((self.X.operator(),)), self.inverse, self.size)

    @cached_property
    def information(self) -> Floats:
        """(p + c, p + c), priors included."""
        return self.half.T @ self.half

    @cached_property
    def inverse(self) -> Floats:
        """(p + c, p + c) upper triangular R, R R.T the covariance of the sizes."""
        return solve_triangular(self.half, np.eye(len(self.half)), lower=False, check_finite=False)

    def covariance(self, number: int) -> Floats:
        """(c, c) of one term's sizes."""
        part = self.inverse[self.slices[number]]
        return part @ part.T

    def known(self) -> float:
        """How many numbers of the terms the data determine, priors aside."""
        prior = self.prior()
        return float((prior > 0).sum() - prior @ (self.inverse**2).sum(axis=1))

    def prior(self) -> Floats:
        """(p + c,) inverse squares of the sizes that priors expect, 0 for the freedoms."""
        return np.concatenate([np.zeros(self.arms.freedoms.shape[2])] + [1 / term.prior**2 for term in self.terms])

    def cost(self) -> float:
        """Whitened squares and the priors' part: what a term's delta chi-square is a fall of."""
        return float((self.y[self.used] ** 2).sum() + self.prior() @ self.theta**2)

    def without_terms(self, numbers: Sequence[int]) -> "Fit":
        """The Fit of the other terms with weights and poses as they are: rows and columns of the information struck
        out.
        """
        keep = np.ones(self.X.count, bool)
        for number in numbers:
            keep[self.slices[number]] = False
        terms = tuple(term for i, term in enumerate(self.terms) if i not in numbers)
        X = self.X.without_parts([1 + number for number in numbers])
        return self._solved(terms, X, self.information[np.ix_(keep, keep)], self.right[keep])

    def with_terms(self, terms: Sequence[Term]) -> "Fit":
        """The Fit with more terms, weights and poses as they are."""
        raw = Columns(self.arms.joints, tuple(term.part for term in terms))
        more = raw.take(self.used).whitened(self.W[self.used])
        cross, own = self.X.cross(more), more.gram()
        own[np.diag_indices_from(own)] += (
            np.concatenate([1 / term.prior**2 for term in terms]) + LOOSE * np.diag(own) + 1e-300
        )
        H = np.block([[self.information, cross], [cross.T, own]])
        right = np.concatenate([self.right, more.onto(self.target[self.used][..., None])[:, 0]])
        return self._solved((*self.terms, *terms), self.X.with_parts(more.parts), H, right)

    @property
    def target(self) -> Floats:
        """(n, k) whitened, what the geometry left."""
        return (self.W @ self.arms.left[..., None])[..., 0]

    def _solved(self, terms: tuple[Term, ...], X: Columns, H: Floats, right: Floats) -> "Fit":
        factor = cho_factor(H)
        theta = cho_solve(factor, right)
        left = self.arms.left - term_columns(self.arms, terms).at(theta[:, None])[..., 0]
        y = (self.W @ left[..., None])[..., 0]
        return replace(
            self,
            terms=terms,
            X=X,
            right=right,
            half=np.triu(factor[0]),
            theta=theta,
            left=left,
            y=y,
            slices=_slices(self.arms, terms),
        )

    def criterion(self) -> float:
        """Bayesian information criterion with its weights as they are."""
        return self.cost() + (self.known() + sum(one.candidate.extra for one in self.terms)) * np.log(self.size)

    def part(self, number: int) -> Floats:
        """(n,) rad by which a term turns its joint in every pose, or m by which it moves the tool where it acts on the
        whole arm.
        """
        moved = self.terms[number].weights @ self.theta[self.slices[number]]
        return moved[:, 0] if self.terms[number].candidate.joint is not None else np.linalg.norm(moved[:, :3], axis=1)


def fit_terms_to_poses(
    arms: Arms,
    terms: Sequence[Term] = (),
    train: Booleans | None = None,
    start: Weighing | None = None,
    rounds: int = ROUNDS,
) -> Fit:
    """Fit of terms to an arm's poses, those of a mask train (n,), all by default.

    start : Weighing to begin with; rounds : of weighing anew
    """
    used = np.ones(len(arms), bool) if train is None else train
    raw, k = term_columns(arms, terms), arms.left.shape[1]
    prior = np.concatenate([np.zeros(arms.freedoms.shape[2])] + [1 / term.prior**2 for term in terms])
    retained, weighing = raw.take(used), _weighed(arms, arms.left, used, 0.0) if start is None else start
    for last in reversed(range(rounds)):
        W = weighing.whitening(arms.own)
        X = retained.whitened(W[used])
        H = X.gram()
        H[np.diag_indices_from(H)] += prior + LOOSE * np.diag(H) + 1e-300
        factor = cho_factor(H)
        right = X.onto(W[used] @ arms.left[used][..., None])[:, 0]
        theta = cho_solve(factor, right)
        left = arms.left - raw.at(theta[:, None])[..., 0]
        if not last:
            break
        inverse = solve_triangular(factor[0], np.eye(len(H)), lower=False, check_finite=False)
        fitted_count = len(H) - (prior * (inverse**2).sum(axis=1)).sum()
        new = _weighed(arms, left, used, min(fitted_count / (k * used.sum()), 0.8))
        if new.like(weighing):
            break
        weighing = new
    y = (W @ left[..., None])[..., 0]
    return Fit(
        arms, tuple(terms), used, W, X, right, np.triu(factor[0]), theta, left, y, weighing, _slices(arms, terms)
    )


def _weighed(arms: Arms, left: Floats, used: Booleans, share: float) -> Weighing:
    scatter = excess_scatter(left[used], arms.own[used], share)
    white = np.linalg.solve(np.linalg.cholesky(arms.own + np.diag(scatter**2)), left[..., None])[..., 0]
    return Weighing(scatter, robust_weights((white**2).sum(axis=1), left.shape[1]))


def term_columns(arms: Arms, terms: Sequence[Term]) -> Columns:
    """Columns of terms.

    They follow those of the freedoms, m and rad per unit.
    """
    return Columns(arms.joints, (Part(None, arms.freedoms), *(term.part for term in terms)))


def _slices(arms: Arms, terms: Sequence[Term]) -> tuple[slice, ...]:
    edges = np.cumsum([arms.freedoms.shape[2], *(len(term.prior) for term in terms)])
    return tuple(slice(a, b) for a, b in zip(edges[:-1], edges[1:]))
