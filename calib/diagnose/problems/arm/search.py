"""How much each candidate at an arm's joints would explain, what is admitted and the geometry's freedoms taken out."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.diagnose.engine.candidates import Node
from calib.diagnose.engine.linear import Column
from calib.diagnose.engine.products import FrameProducts, Normal, Solved, framewise, solve_with_prior
from calib.diagnose.engine.score import Score, at_node
from calib.diagnose.engine.sinusoids import sums
from calib.diagnose.problems.arm.candidates import Form, JointCandidate
from calib.diagnose.problems.arm.fit import Fit

CHUNK = 96  # nodes at a time
REFINE = 8  # halvings of the step about the best order
SLOWEST = 0.05  # cycles per radian times 2 pi; a sinusoid of a lower order is a line


def search(fit: Fit, candidates: list[JointCandidate], least: float = 0.0, cluster: int = 1,
           progress: Callable[[int, int], None] | None = None) -> list[Score]:
    """[Score] of all candidates, the greatest raw delta BIC first. least : raw delta BIC of those listed; progress : called with (done, of)"""
    known, out = {}, []
    for i, candidate in enumerate(candidates):
        if candidate.joint not in known:
            known[candidate.joint] = joint_products(fit, candidate.joint)
        score = _score(fit, candidate, known[candidate.joint], least, cluster)
        if score is not None:
            out.append(score)
        if progress:
            progress(i + 1, len(candidates))
    return sorted(out, key=lambda s: -s.raw_delta_bic(fit.size))


def joint_products(fit: Fit, joint: int | None) -> FrameProducts:
    """FrameProducts of the used poses for a joint's turn (index), or for the measured tangents (None)."""
    A = _directions(fit, joint)
    turned = np.swapaxes(A, 1, 2)
    return FrameProducts((turned @ fit.y[fit.used][..., None])[..., 0], turned @ A, fit.linear.onto(turned @ fit.X[fit.used]))


def column_of(fit: Fit, score: Score) -> Column:
    """Column (1) of what a Score's candidate does as scanned, whitened, freedoms not yet taken out."""
    w = score.candidate.weights(score.node)[fit.used] @ score.coefficients
    return Column(((_directions(fit, score.candidate.joint) @ w[..., None]).reshape(-1, 1),))


def _directions(fit: Fit, joint: int | None) -> np.ndarray:
    """(m, k, a) whitened, of the used poses."""
    return fit.W[fit.used] @ fit.arms.directions(joint)[fit.used]


def _score(fit: Fit, candidate: JointCandidate, products: FrameProducts, least: float, cluster: int) -> Score | None:
    solved = solved_grid(fit, candidate, products)
    best = int(np.argmax(solved.delta_chi2 - solved.rank * np.log(fit.size)))
    node = candidate.grid[best]
    if candidate.step:
        node, top = _finer(fit, candidate, products, node)
        if top.delta_chi2[0] > solved.delta_chi2[best]:
            deltas, coefficients = solved.delta_chi2.copy(), list(solved.coefficients)
            deltas[best], coefficients[best] = top.delta_chi2[0], top.coefficients[0]
            solved = solved._replace(delta_chi2=deltas, coefficients=coefficients)
        else:
            node = candidate.grid[best]
    if solved.delta_chi2[best] - (np.ceil(solved.rank[best]) + candidate.extra) * np.log(fit.size) <= least:
        return None
    return at_node(fit.linear, candidate, best, node, solved, products, weights(fit, candidate, node), cluster)


def weights(fit: Fit, candidate: JointCandidate, node: Node) -> np.ndarray:
    """(m, a, q) weights of the used poses at a node."""
    return candidate.weights(node)[fit.used]


def solved_grid(fit: Fit, candidate: JointCandidate, products: FrameProducts) -> Solved:
    """Solved of all of a candidate's nodes; sinusoids of even orders and steps in time by short cuts."""
    if candidate.step:
        return solve_with_prior(_orders(candidate, fit.arms.q[fit.used, candidate.joint], products), candidate.prior(candidate.grid[0]))
    if candidate.form is Form.STEP:
        return solve_with_prior(_steps(candidate, fit.arms.t[fit.used], products), candidate.prior(candidate.grid[0]))
    return solved_nodes(fit, candidate, products, candidate.grid)


def solved_nodes(fit: Fit, candidate: JointCandidate, products: FrameProducts, nodes: list[Node]) -> Solved:
    """Solved of any nodes, one after the other."""
    parts = []
    for start in range(0, len(nodes), CHUNK):
        chunk = nodes[start : start + CHUNK]
        part = [weights(fit, candidate, node) for node in chunk]
        even = len({w.shape[2] for w in part}) == 1
        groups = [(np.stack(part), chunk[0])] if even else [(w[None], node) for w, node in zip(part, chunk)]
        parts += [solve_with_prior(framewise(products, w), candidate.prior(node)) for w, node in groups]
    return Solved.of(parts)


def _finer(fit: Fit, candidate: JointCandidate, products: FrameProducts, node: Node) -> tuple[Node, Solved]:
    """(node, Solved of it) of the best order about a node."""
    step, top = candidate.step, None
    for _ in range(REFINE):
        step /= 2
        near = [{candidate.sought: max(node[candidate.sought] + d * step, SLOWEST)} for d in (-1, 0, 1)]
        found = solved_nodes(fit, candidate, products, near)
        i = int(np.argmax(found.delta_chi2))
        node, top = near[i], Solved(found.delta_chi2[i : i + 1], [found.coefficients[i]], found.rank[i : i + 1], found.seen[i : i + 1])
    return node, top


def _orders(candidate: JointCandidate, q: np.ndarray, products: FrameProducts) -> Normal:
    """Normal of sine and cosine at every order of a candidate, multiples of its step."""
    at = np.round([node[candidate.sought] / candidate.step for node in candidate.grid]).astype(int)
    beta, gamma, kappa = products.beta, products.gamma[:, 0, 0], products.kappa[:, 0]
    first, count = at.min(), np.ptp(at) + 1
    table = sums(q, np.column_stack([beta, kappa]), candidate.step, first, count)[at - first]
    table = np.stack([table.imag, table.real], axis=1)  # (s, 2, 1 + p)
    twice = sums(q, gamma[:, None], 2 * candidate.step, first, count)[at - first, 0]
    whole, K = gamma.sum(), table[:, :, 1:]
    G = np.stack([whole - twice.real, twice.imag, twice.imag, whole + twice.real], axis=1).reshape(-1, 2, 2) / 2
    return Normal(table[:, :, 0], G - K @ np.swapaxes(K, 1, 2), np.einsum("sqq->sq", G).copy())


def _steps(candidate: JointCandidate, t: np.ndarray, products: FrameProducts) -> Normal:
    """Normal of a step at each of a candidate's times."""
    at = np.searchsorted(t, [node[candidate.sought] for node in candidate.grid])
    b, gamma, kappa = (np.concatenate([np.cumsum(part[::-1], axis=0)[::-1], np.zeros((1, *part.shape[1:]))])[at]
                       for part in (products.beta[:, 0], products.gamma[:, 0, 0], products.kappa[:, 0]))
    return Normal(b[:, None], (gamma - (kappa**2).sum(axis=1))[:, None, None], gamma[:, None].copy())


def confined(candidate: JointCandidate, nodes: list[Node]) -> JointCandidate:
    """The candidate with some nodes for its grid; their orders need not be even any more."""
    return replace(candidate, grid=nodes, step=0.0)
