"""Scores of candidates, and their significance.

Explained chi-square, its chance, its cost in BIC, and the best node of its grid.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear
from scipy.special import chdtri, fdtri

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    C,
    Candidate,
    Node,
    Role,
    SelectionPolicy,
    UsualRange,
)
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import MANY, residual_dispersion, scan_p_value
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    Solved,
    normal_equations_by_direction_weights,
)
from calib.diagnosis.engine.linear_residual_model import RANK, LinearModel, Projection
from calib.identify.bounded_and_robust_least_squares_fit import bounded_step_and_covariance
from rig.array_and_json_types import Booleans, Floats
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

BEYOND = 0.3  # standard deviation of the logarithm of a parameter above what rigs show
WRONG_SIGN = 12.0  # minus twice the logarithm of the chance that a parameter has the sign that rigs do not show
NOTHING = 1e-3  # of what a scan found, a size that columns have beside others and that is none
MOST_OF_SCATTER = 1 - 1e-6  # of it, that an effect explains: the rest is rounding
SEVERAL = 3  # axes that show a name, from which it is asked whether all together explain more than any other
SAME = 0.02  # of a finding's evidence, by which two scans beside the same terms may differ and still be the same


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Score(FieldSummaryRepr, Generic[C]):
    """The best of a candidate's grid. node : of it; coefficients : (q,)

    delta_chi2 : by which the whitened sum of squares falls, dispersion allowed for; p_value : of the grid's greatest
        delta
    freedom : parameters fitted, nonlinear ones included; dispersion; seen : share of the candidate's own size that
        nuisances leave, 0..1
    curve : delta over the grid; values : {name: number} of what `candidate.usual` speaks of
    """

    candidate: C
    node: Node
    coefficients: Floats
    delta_chi2: float
    p_value: float
    freedom: int
    dispersion: float
    seen: float
    curve: Floats
    values: dict[str, float] = field(default_factory=dict)

    def delta_bic(self, size: int) -> float:
        """Bayesian information criterion's verdict: how much better than nothing, for residuals of a size."""
        return self.delta_chi2 - self.freedom * np.log(size)

    def raw_delta_bic(self, size: int) -> float:
        """The same with the dispersion not allowed for, to rank by: what is not modelled yet disperses all, the right
        answer most.
        """
        return self.delta_chi2 * self.dispersion - self.freedom * np.log(size)

    def evidence(self, size: int) -> float:
        """Minus twice the logarithm of how much likelier than nothing, up to what all share: to compare candidates
        by.
        """
        return self.delta_chi2 * self.dispersion - self.complexity(size)

    def likelihood_ratio(self, frames: int | None) -> float:
        """Twice the logarithm of the likelihood ratio against nothing that a fit would show.

        frames : of an axis, whose scatter a scan takes from residuals that still contain the effect, so that delta
        chi-square stays below their number however large the effect (Seber and Lee, Linear regression analysis, 2003,
        ch. 4); None where the scatter is not an axis' own
        """
        explained = self.delta_chi2 * self.dispersion
        return explained if frames is None else float(-frames * np.log1p(-min(explained / frames, MOST_OF_SCATTER)))

    def complexity(self, size: int) -> float:
        """What its parameters cost it against other hypotheses, as minus twice a logarithm, for residuals of a size.

        A number that rigs show over some range is as likely at every order of magnitude of it, and hardly ever beyond
        or of the wrong sign: its cost is that of Laplace's approximation. A grid's parameter costs what the search over
        it shows; all else, the logarithm of the size for each (MacKay, Information theory, inference and learning
        algorithms, 2003, ch. 28).
        """
        usual = self.candidate.usual
        if usual is None:
            return float(self.freedom * np.log(size))
        sharp = max(np.sqrt(max(self.delta_chi2, 0.0) / max(len(usual), 1)), 1.0)
        cost = sum(_cost(u, self.values[u.name], sharp) for u in usual)
        cost += np.log(size) * (
            len(self.coefficients) - self.candidate.tied - sum(u.role is not Role.SIZE for u in usual)
        )
        if self.candidate.searched and len(self.curve) > 1:
            cost -= 2 * np.log(np.mean(np.exp((self.curve - self.curve.max()) / 2)))
        elif self.candidate.extra and not any(u.role is Role.SIZE for u in usual):
            cost += self.candidate.extra * np.log(size)
        return float(cost)


@dataclass(frozen=True, slots=True, eq=False)
class Alternative(Generic[C]):
    """score : of a hypothesis in place of a finding; behind : how much less likely it is, as minus twice a logarithm
    cosine : between what the two do, nuisances taken out"""

    score: Score[C]
    behind: float
    cosine: float


class Scans(Generic[C]):
    """Scores of all candidates by the terms that were admitted when they were scanned, and the alternatives of terms
    confirmed: what is searched once is not searched again.
    """

    def __init__(self) -> None:
        self._by_terms: dict[frozenset[int], list[Score[C]]] = {}
        self._confirmed: dict[int, tuple[list[C], Score[C], list[Alternative[C]]]] = {}

    def keep(self, terms: Sequence[C], scores: list[Score[C]]) -> None:
        """Keep the Scores of a scan beside some terms."""
        self._by_terms[frozenset(map(id, terms))] = scores

    def of_same_terms(self, terms: Sequence[C], score: Score[C], size: int) -> tuple[list[Score[C]], Score[C]] | None:
        """(Scores of the scan beside the same terms, a candidate's among them) where it gave that candidate the
        evidence that a Score gives it now; else None.
        """
        scores = self._by_terms.get(frozenset(map(id, terms)), [])
        own = next((s for s in scores if s.candidate is score.candidate), None)
        if own is None or not _is_same_evidence(own, score, size):
            return None
        return scores, own

    def keep_alternatives(self, others: list[C], score: Score[C], alternatives: list[Alternative[C]]) -> None:
        """Keep the alternatives of a term with a Score that was confirmed beside other terms."""
        self._confirmed[id(score.candidate)] = others, score, alternatives

    def alternatives(self, others: list[C], score: Score[C], size: int) -> list[Alternative[C]] | None:
        """The alternatives of a term confirmed before that still explains as much, beside others of which none that
        came or went is among these; None where they are to be sought anew."""
        before, known, alternatives = self._confirmed.get(id(score.candidate), (others, None, []))
        if known is None or not _is_same_evidence(known, score, size):
            return None
        changed = {(c.name, c.place) for c in before + others if (c in before) != (c in others)}
        listed = {(a.score.candidate.name, a.score.candidate.place) for a in alternatives}
        return None if changed & listed else alternatives


def _is_same_evidence(one: Score[C], other: Score[C], size: int) -> bool:
    """Whether two Scores of a candidate, each beside some terms, tell the same."""
    return abs(one.evidence(size) - other.evidence(size)) <= SAME * abs(other.evidence(size))


def is_significant(
    score: Score[C], candidate_count: int, independent_residual_count: int, policy: SelectionPolicy
) -> bool:
    """Whether a Score is significant.

    It is where it is too good for chance over all candidates, and worth its parameters.
    """
    return (
        score.p_value * candidate_count <= policy.alpha
        and score.delta_bic(independent_residual_count) >= policy.delta_bic
    )


class Threshold(NamedTuple):
    """What candidates are admitted by: how many there are, of how many independent residuals, by which policy.

    is_scatter_estimated : whether what is not admitted counts as scatter of all residuals, so that delta chi-square
        stays below their number however large the effect
    """

    candidate_count: int
    independent_residual_count: int
    policy: SelectionPolicy
    is_scatter_estimated: bool = False

    def delta_chi2_by_noise_alone(self, delta_chi2: float) -> float:
        """Delta chi-square by the noise alone that an effect takes to show one, infinite where none suffices."""
        if not self.is_scatter_estimated:
            return delta_chi2
        left = 1 - delta_chi2 / self.independent_residual_count
        return delta_chi2 / left if left > 0 else np.inf


def least_significant_delta_chi2(rank: float, extra: int, scan: tuple[int, float], threshold: Threshold) -> float:
    """Least delta chi-square at which a candidate is significant.

    Dispersion is allowed for.
    rank : parameters that the data determine; extra : those that the search chooses
    scan : (nodes of the grid, each of which counts as a look of its own, degrees of freedom of the dispersion)
    """
    nodes, freedom = scan
    linear = max(round(rank), 1)
    policy = threshold.policy
    chance = policy.alpha / threshold.candidate_count / nodes
    if freedom < MANY:  # Fisher's F, by its reciprocal, since chance is far below what one less it resolves
        least = linear / float(fdtri(max(freedom, 1.0), linear, chance))
    else:
        least = float(chdtri(linear, chance))
    return max(least, policy.delta_bic + (np.ceil(rank) + extra) * np.log(threshold.independent_residual_count))


def may_become_significant_when_fitted(
    score: Score[C], candidate_count: int, independent_residual_count: int, policy: SelectionPolicy
) -> bool:
    """Whether a Score that is not significant may become so when fitted.

    It is unlikely by chance, or explains much by whichever frames.
    """
    return policy.hidden > 0 and (
        score.p_value * candidate_count <= policy.hidden
        or score.raw_delta_bic(independent_residual_count) >= policy.delta_bic
    )


def score_raised_to_likelihood_ratio(score: Score[C], likelihood_ratio: float, frames: int) -> Score[C]:
    """Score raised to the likelihood ratio of a fit.

    Its delta chi-square is, where that is greater.
    """
    delta = likelihood_ratio * max(1 - score.freedom / frames, 0.0) / score.dispersion
    if delta <= score.delta_chi2:
        return score
    return replace(score, delta_chi2=delta, p_value=float(score.p_value * np.exp(-(delta - score.delta_chi2) / 2)))


def _best_scores_at_axes(promising: list[Score[C]], name: str, size: int) -> list[Score[C]]:
    """The best Score of one effect at each axis, the most convincing first."""
    best: dict[str, Score[C]] = {}
    for s in promising:
        if s.candidate.name == name and s.candidate.site.is_axis:
            known = best.get(s.candidate.place)
            if known is None or s.evidence(size) > known.evidence(size):
                best[s.candidate.place] = s
    return sorted(best.values(), key=lambda s: -s.raw_delta_bic(size))


def scores_of_best_effect_at_several_axes(
    promising: list[Score[C]], scores: list[Score[C]], size: int, project: Callable[[list[Score[C]]], Projection]
) -> list[Score[C]]:
    """Scores of the best effect at several axes.

    It explains most at them together; the most convincing is first; none where one score alone explains more.
    Axes that are built alike fail alike, and what one hypothesis explains of all is less than what each does of its
    own. An axis that shows nothing alone may do so beside the others: what all have in common, a hypothesis about the
    whole machine may have taken up already, and of lags that have one sign only the longer ones are left to be seen.
    scores : all of a scan; project : a function of scores at several axes, the Projection of a column for each
    """
    found: list[Score[C]] = []
    most = promising[0].raw_delta_bic(size)
    for name in dict.fromkeys(s.candidate.name for s in promising if s.candidate.site.is_axis):
        group = [s for s in _best_scores_at_axes(scores, name, size) if s.delta_chi2 > 0]
        if len(group) < SEVERAL:
            continue
        sizes, gain = joint_fit_and_explained_sum_of_squares(
            project(group), np.array([_may_be_opposite(s) for s in group])
        )
        worth = gain - sum(s.freedom for s, there in zip(group, sizes != 0, strict=True) if there) * np.log(size)
        if np.count_nonzero(sizes) >= SEVERAL and worth > most:
            most, found = worth, [s for s, there in zip(group, sizes != 0, strict=True) if there]
    return found


def joint_fit_and_explained_sum_of_squares(projected: Projection, may_be_negative: Booleans) -> tuple[Floats, float]:
    """Coefficients (k,) of columns fitted jointly to a residual, and the sum of squares they explain.

    may_be_negative : (k,) whether a column's size may be below zero
    """
    values, vectors = np.linalg.eigh(projected.gram)
    there = values > RANK * max(values.max(initial=0.0), 1e-300)
    root = np.sqrt(values[there])[:, None] * vectors[:, there].T
    low = np.where(may_be_negative, -np.inf, 0.0)
    sizes = lsq_linear(root, (vectors[:, there].T @ projected.right) / np.sqrt(values[there]), (low, np.inf)).x
    sizes = np.where(~may_be_negative & (sizes < NOTHING), 0.0, sizes)
    return sizes, float(2 * projected.right @ sizes - sizes @ projected.gram @ sizes)


def _may_be_opposite(score: Score[C]) -> bool:
    """Whether what a Score's candidate does may be done the other way round as well."""
    theta = score.coefficients
    return bool(len(theta)) and bool((score.candidate.allowed(-theta) == -theta).all())


def best_node_score(
    model: LinearModel,
    candidate: C,
    solved: Solved,
    products: FrameProducts,
    weights_at: Callable[[int], Floats],
    least_delta_chi2: float = -np.inf,
) -> Score[C]:
    """Score of the best node of a candidate's grid.

    solved : Solved, one for each node; weights_at : a function of the best node's index, its weights (F, a, q)
    least_delta_chi2 : of delta chi-square; of what explains less no dispersion is asked, and its chance counts as
        certain
    """
    best = int(np.argmax(solved.delta_chi2 - solved.rank * np.log(model.size)))
    if solved.delta_chi2[best] < least_delta_chi2:
        return score_of_insignificant_candidate_without_dispersion(candidate, solved, best)
    return score_at_node(model, candidate, best, candidate.grid[best], solved, products, weights_at(best))


def score_of_insignificant_candidate_without_dispersion(candidate: C, solved: Solved, solved_index: int) -> Score[C]:
    """Score of an insignificant candidate at its best node, its dispersion not computed."""
    return Score(
        candidate,
        dict(candidate.grid[solved_index]),
        candidate.allowed(solved.coefficients[solved_index]),
        float(solved.delta_chi2[solved_index]),
        1.0,
        int(np.ceil(solved.rank[solved_index])) + candidate.extra,
        1.0,
        float(solved.seen[solved_index]),
        solved.delta_chi2,
    )


def score_at_node(
    model: LinearModel,
    candidate: C,
    solved_index: int,
    node: Node,
    solved: Solved,
    products: FrameProducts,
    weights: Floats,
    correlated_frames: int = 1,
) -> Score[C]:
    """Score of a candidate at one node of its grid.

    It is that of solved_index in solved.
    weights : (F, a, q) there
    """
    coefficients, rank, deltas = solved.coefficients[solved_index], solved.rank[solved_index], solved.delta_chi2
    allowed = candidate.allowed(coefficients)
    if (
        allowed != coefficients
    ).any():  # what the data want is forbidden: it counts for as much as it explains at the bound
        normal = normal_equations_by_direction_weights(products, weights[None])
        coefficients = _best_within_bounds(candidate, normal.b[0], normal.G[0]) if len(allowed) > 1 else allowed
        explained = 2 * normal.b[0] @ coefficients - coefficients @ normal.G[0] @ coefficients
        deltas = np.minimum(deltas, explained)
    found = residual_dispersion(
        model, products, weights, coefficients if len(coefficients) else np.ones(1), correlated_frames
    )
    curve = deltas / found.ratio
    same = (
        solved.rank == rank
    )  # Davies' process has one number of parameters; Bonferroni over the numbers that there are
    p = min(1.0, scan_p_value(curve[same], round(float(rank)), found.freedom) * len(np.unique(solved.rank)))
    return Score(
        candidate,
        dict(node),
        coefficients,
        float(curve[solved_index]),
        p,
        int(np.ceil(rank)) + candidate.extra,
        found.ratio,
        float(solved.seen[solved_index]),
        curve,
    )


def _best_within_bounds(candidate: Candidate, b: Floats, G: Floats) -> Floats:
    """(q,) coefficients within a candidate's bounds that explain most, of normal equations G x = b; where nuisances
    take a direction up nearly whole, what noise would make of it is held by the bounds, as by a prior of their size."""
    if candidate.bounds is None:
        return candidate.allowed(np.asarray(np.linalg.lstsq(G, b, rcond=None)[0], float))
    low, high = candidate.bounds
    ridge = np.diag((2 / (high - low)) ** 2)
    ends, none = np.stack([low, high], axis=1), np.zeros((0, len(b)))
    return candidate.allowed(bounded_step_and_covariance(b, G + ridge, np.zeros(len(b)), ends, none)[0])


def _cost(usual: UsualRange, value: float, sharp: float) -> float:
    """Of a number at a value that is `sharp` standard deviations from nothing: how little of what rigs show the data
    leave of it.
    """
    low, high = usual.low, usual.high
    if usual.role is Role.INVERSE:
        low, high, value = 1 / high, 1 / low, 1 / value
    cost = 2 * np.log(sharp * np.log(high / low) * (2 if usual.signed else 1) / np.sqrt(2 * np.pi))
    if value < 0 and not usual.signed:
        cost += WRONG_SIGN
    return cost + (np.log(max(abs(value) / high, 1.0)) / BEYOND) ** 2
