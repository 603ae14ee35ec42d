"""Scores (delta chi-square) of all candidates on an arm's linearised model.

Each at the best node of its grid.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import score_at_node
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Node
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    Normal,
    Solved,
    normal_equations_by_direction_weights,
    sinusoid_weighted_sums,
    solve_with_prior,
)
from calib.diagnosis.engine.linear_residual_model import Column
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    Form,
    JointCandidate,
    JointScore,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit
from rig.array_and_json_types import Floats, Integers

CHUNK = 96  # nodes at a time
REFINE, FINER = 4, 2  # rounds about the best order, each with a step so many times as fine
BETWEEN = 1.3  # times what a node explains, the most that an order between two of them does
PROMISING, SLOW = (
    64,
    24,
)  # nodes of a long grid of which nuisances are taken out: those that explain most, and the first
# times what a term's first number has to bring, what each of a curve's has to: neighbouring poses tell of a curve
# nearly the same
MANY = 1.5
SEEN = 4.0  # times what a later node explains with the nuisances in, the most that it does without
SLOWEST = 0.05  # cycles per radian times 2 pi; a sinusoid of a lower order is a line


def score_candidates(
    fit: Fit,
    candidates: list[JointCandidate],
    least_delta_bic: float = 0.0,
    correlated_frames: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[JointScore]:
    """Scores of candidates.

    The greatest raw delta BIC is first.
    least_delta_bic : of those listed, raw: candidates up to it are left out; progress : called with (done, of)
    """
    known, out = {}, []
    for i, candidate in enumerate(candidates):
        if candidate.joint not in known:
            known[candidate.joint] = joint_motion_normal_equations_by_frame(fit, candidate.joint)
        score = _score(fit, candidate, known[candidate.joint], least_delta_bic, correlated_frames)
        if score is not None:
            out.append(score)
        if progress:
            progress(i + 1, len(candidates))
    return sorted(out, key=lambda s: -s.raw_delta_bic(fit.size))


def joint_motion_normal_equations_by_frame(fit: Fit, joint: int | None) -> FrameProducts:
    """Normal equations of a joint's motion, frame by frame (FrameProducts).

    They are inner products for the fitted poses; of the measured tangents where joint is None.
    """
    A = _directions(fit, joint)
    turned = np.swapaxes(A, 1, 2)
    return FrameProducts((turned @ fit.y[fit.used][..., None])[..., 0], turned @ A, fit.X.along(A), fit.inverse)


def candidate_column_at_scanned_parameters(fit: Fit, score: JointScore) -> Column:
    """Column (1) of a Score's candidate at its scanned parameters.

    Whitened, freedoms not yet projected out.
    """
    w = score.candidate.weights(score.node)[fit.used] @ score.coefficients
    return Column(((_directions(fit, score.candidate.joint) @ w[..., None]).reshape(-1, 1),))


def _directions(fit: Fit, joint: int | None) -> Floats:
    """(m, k, a) whitened, of the used poses."""
    return fit.W[fit.used] @ fit.arms.directions(joint)[fit.used]


def _score(
    fit: Fit, candidate: JointCandidate, products: FrameProducts, least: float, cluster: int
) -> JointScore | None:
    log = np.log(fit.size)
    solved = solve_candidate_at_all_nodes(fit, candidate, products, least)
    best = int(np.argmax(solved.delta_chi2 - solved.rank * log))
    node, penalty = candidate.grid[best], (np.ceil(solved.rank[best]) + candidate.extra) * log
    if candidate.step and BETWEEN * solved.delta_chi2[best] - penalty > least:
        finer, top = _finer(fit, candidate, products, node)
        if top.delta_chi2[0] > solved.delta_chi2[best]:
            deltas, coefficients = solved.delta_chi2.copy(), list(solved.coefficients)
            deltas[best], coefficients[best] = top.delta_chi2[0], top.coefficients[0]
            solved, node = solved._replace(delta_chi2=deltas, coefficients=coefficients), finer
    if solved.delta_chi2[best] - penalty <= least:
        return None
    score = score_at_node(
        fit.linear, candidate, best, node, solved, products, _node_weights(fit, candidate, node), cluster
    )
    fewer = (
        int(np.argmax(solved.delta_chi2 / score.dispersion - MANY * solved.rank * log)) if candidate.vector else best
    )
    if fewer == best:  # many numbers pay for themselves with the dispersion allowed for
        return score
    node = candidate.grid[fewer]
    return score_at_node(
        fit.linear, candidate, fewer, node, solved, products, _node_weights(fit, candidate, node), cluster
    )


def _node_weights(fit: Fit, candidate: JointCandidate, node: Node) -> Floats:
    """(m, a, q) weights of the used poses at a node."""
    return candidate.weights(node)[fit.used]


def solve_candidate_at_all_nodes(
    fit: Fit, candidate: JointCandidate, products: FrameProducts, least_gain: float = 0.0
) -> Solved:
    """Least-squares solution (Solved) of a candidate at all nodes of its grid.

    By short cuts for even orders and time steps.
    """
    if candidate.step:
        long = _orders(candidate, fit.arms.q[fit.used, candidate.joint], products)
    elif candidate.form is Form.STEP:
        long = _steps(candidate, fit.arms.t[fit.used], products)
    else:
        return solve_candidate_at_nodes(fit, candidate, products, candidate.grid)
    return _promising(long, candidate.prior(candidate.grid[0]), least_gain)


def solve_candidate_at_nodes(fit: Fit, candidate: JointCandidate, products: FrameProducts, nodes: list[Node]) -> Solved:
    """Least-squares solution (Solved) of a candidate at the given nodes, one by one."""
    parts = []
    for start in range(0, len(nodes), CHUNK):
        chunk = nodes[start : start + CHUNK]
        part = [_node_weights(fit, candidate, node) for node in chunk]
        even = len({w.shape[2] for w in part}) == 1
        groups = [(np.stack(part), chunk[0])] if even else [(w[None], node) for w, node in zip(part, chunk)]
        parts += [
            solve_with_prior(normal_equations_by_direction_weights(products, w), candidate.prior(node))
            for w, node in groups
        ]
    return Solved.of(parts)


def _finer(fit: Fit, candidate: JointCandidate, products: FrameProducts, node: Node) -> tuple[Node, Solved]:
    """(node, Solved of it) of the best order about a node."""
    reach, order, prior = candidate.step, node[candidate.sought], candidate.prior(node)
    q = fit.arms.q[fit.used, candidate.joint]
    for _ in range(REFINE):
        orders = np.maximum(order + reach * np.linspace(-1, 1, 2 * FINER + 1), SLOWEST)
        angles = orders[:, None] * q
        found = solve_with_prior(
            normal_equations_by_direction_weights(
                products, np.stack([np.sin(angles), np.cos(angles)], axis=-1)[:, :, None]
            ),
            prior,
        )
        i = int(np.argmax(found.delta_chi2))
        order, reach = float(orders[i]), reach / FINER
    return {candidate.sought: order}, Solved(
        found.delta_chi2[i : i + 1], [found.coefficients[i]], found.rank[i : i + 1], found.seen[i : i + 1]
    )


class LongGrid(NamedTuple):
    """Of s nodes: b (s, q) projections of the residual, G (s, q, q) Gram matrices with the nuisances still in
    onto : indices (c,) -> (c, q, r) products of these nodes with the nuisances' orthonormal basis"""

    b: Floats
    G: Floats
    onto: Callable[[Integers], Floats]


def _orders(candidate: JointCandidate, q: Floats, products: FrameProducts) -> LongGrid:
    """LongGrid of sine and cosine at every order of a candidate, multiples of its step."""
    at = np.round([node[candidate.sought] / candidate.step for node in candidate.grid]).astype(int)
    beta, gamma, kappa = products.beta, products.gamma[:, 0, 0], products.kappa[:, 0]
    first, count = at.min(), np.ptp(at) + 1
    b = _sine_cosine(sinusoid_weighted_sums(q, beta, candidate.step, first, count)[at - first])[..., 0]
    twice = sinusoid_weighted_sums(q, gamma[:, None], 2 * candidate.step, first, count)[at - first, 0]
    whole = gamma.sum()
    G = np.stack([whole - twice.real, twice.imag, twice.imag, whole + twice.real], axis=1).reshape(-1, 2, 2) / 2

    def onto(chosen: Integers) -> Floats:
        low, span = at[chosen].min(), np.ptp(at[chosen]) + 1
        return products.onto(
            _sine_cosine(sinusoid_weighted_sums(q, kappa, candidate.step, low, span)[at[chosen] - low])
        )

    return LongGrid(b, G, onto)


def _sine_cosine(table: Floats) -> Floats:
    """(s, 2, p) sums with sine and cosine, of sums (s, p) with a complex exponential."""
    return np.stack([table.imag, table.real], axis=1)


def _steps(candidate: JointCandidate, t: Floats, products: FrameProducts) -> LongGrid:
    """LongGrid of a step at each of a candidate's times."""
    at = np.searchsorted(t, [node[candidate.sought] for node in candidate.grid])

    def later(part: Floats) -> Floats:
        return np.concatenate([np.cumsum(part[::-1], axis=0)[::-1], np.zeros((1, *part.shape[1:]))])

    b, G = later(products.beta[:, 0])[at], later(products.gamma[:, 0, 0])[at]
    return LongGrid(
        b[:, None], G[:, None, None], lambda chosen: products.onto(later(products.kappa[:, 0])[at[chosen]])[:, None]
    )


def _promising(long: LongGrid, prior: Floats, least: float) -> Solved:
    """Solved of a LongGrid. Nuisances are taken out of the first nodes, which they may swallow nearly whole, and of
    those that explain most with the nuisances in, as far as `least` is in sight; the others explain at least what they
    do with these in."""
    b, G, onto = long
    raw = np.einsum("sqq->sq", G).copy()
    bound = solve_with_prior(Normal(b, G, raw), prior)
    deltas, rank, coefficients = bound.delta_chi2, bound.rank, list(bound.coefficients)
    top = np.argsort(deltas)[-PROMISING:]
    chosen = np.union1d(top[SEEN * deltas[top] > least], np.arange(min(SLOW, len(b))))
    K = onto(chosen)
    found = solve_with_prior(Normal(b[chosen], G[chosen] - K @ np.swapaxes(K, 1, 2), raw[chosen]), prior)
    deltas[chosen], rank[chosen] = found.delta_chi2, found.rank
    for i, own in zip(chosen, found.coefficients):
        coefficients[i] = own
    return Solved(deltas, coefficients, rank, bound.seen)


def candidate_with_grid_nodes(candidate: JointCandidate, nodes: list[Node]) -> JointCandidate:
    """Candidate with the given nodes as its parameter grid."""
    return replace(candidate, grid=nodes, step=0.0)
