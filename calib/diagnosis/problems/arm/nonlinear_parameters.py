"""Nonlinear parameters of an arm's terms, optimised between grid values, and their uncertainty."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import cho_solve

from calib.diagnosis.engine.frame_inner_products import normal_equations_by_direction_weights, solve_with_prior
from calib.diagnosis.engine.selection_candidates_thresholds_and_outliers import Node
from calib.diagnosis.problems.arm.joint_candidates import Form, JointCandidate
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit, Term
from calib.diagnosis.problems.arm.scores_of_all_candidates import joint_products, solved_nodes
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_parameters_and_covariates import Parameter

SEARCHED = ("size", "log", "even")  # roles of parameters that have a value between those of a grid
CLOSE = 1e-3  # of the way between two values of a grid, to which a parameter is found
MOVES = 4  # times that the way may be moved on where the best is at its end
AROUND = 40  # values of a moment's grid to either side that an interval may reach to
ONE_IN_TWENTY = 3.841459  # chi-square of one degree of freedom
SMALL = 1e-4  # step for a derivative, of the logarithm of a parameter or of an order


class TermCovariance(NamedTuple):
    """names : of r nonlinear parameters; covariance : (q + r, q + r) of the sizes and of these, all else free."""

    names: tuple[str, ...]
    covariance: Floats


def _continuous_parameters(term: Term) -> tuple[Parameter, ...]:
    """The parameters in a term's node that have a value between those of its grid."""
    kind, place = term.candidate.kind, term.candidate.place
    return tuple(p for p in kind.parameters_at(place) if p.role in SEARCHED and p.name in term.node)


def has_continuous_parameters(term: Term) -> bool:
    """Whether a term has nonlinear continuous parameters and is no sinusoid, whose order the search refines."""
    return term.candidate.form is not Form.SINUSOID and bool(_continuous_parameters(term))


def optimise_nonlinear_parameters(fit_without_term: Fit, term: Term) -> Term:
    """Optimise a term's nonlinear parameters on the residuals of a Fit without it; returns the term."""
    products = joint_products(fit_without_term, term.candidate.joint)

    def loss(node: Node) -> float:
        weights = term.candidate.weights(node)[fit_without_term.used]
        normal = normal_equations_by_direction_weights(products, weights[None])
        if not _is_linear(term.candidate):
            size = next(iter(node.values()))
            return float(size * size * normal.G[0, 0, 0] - 2 * size * normal.b[0, 0])
        return -float(solve_with_prior(normal, term.candidate.prior(node)).delta_chi2[0])

    node = dict(term.node)

    def along(name: str, value: float) -> float:
        return loss({**node, name: value})

    for p in _continuous_parameters(term):
        node[p.name] = _least(partial(along, p.name), node[p.name], [n[p.name] for n in term.candidate.grid], p)
    return replace(term, node=node, weights=term.candidate.weights(node), prior=term.candidate.prior(node))


def _is_linear(candidate: JointCandidate) -> bool:
    """Whether its sizes are coefficients; otherwise its size is the value in the node."""
    return bool(candidate.specs[0].linear)


def term_parameter_covariance(fit: Fit, number: int) -> TermCovariance:
    """TermCovariance of one term: of its sizes and nonlinear parameters together."""
    term, theta = fit.terms[number], fit.theta[fit.slices[number]]
    parameters = _continuous_parameters(term)
    if not parameters:
        return TermCovariance((), fit.covariance(number))
    slopes = np.stack([_slope(term, p, theta) for p in parameters], axis=-1)
    if not _is_linear(term.candidate):
        rest = fit.without_terms([number])
        left = _seen(rest, term, term.weights + slopes * theta)[0]
        return TermCovariance((), 1 / np.maximum(left.T @ left, 1e-300))
    left, leaning = _seen(fit, term, slopes)
    own = np.linalg.inv(left.T @ left + 1e-300 * np.eye(len(parameters)))
    lean = leaning[fit.slices[number]]  # how the sizes lean with the parameters
    return TermCovariance(
        tuple(p.name for p in parameters),
        np.block([[fit.covariance(number) + lean @ own @ lean.T, -lean @ own], [-own @ lean.T, own]]),
    )


def onset_time_interval(fit: Fit, number: int, dispersion: float) -> tuple[float, float]:
    """(earliest, latest) s at which the onset of a term may lie.
    dispersion : that its score allows for
    """
    term, rest = fit.terms[number], fit.without_terms([number])
    name = next(p.name for p in term.candidate.kind.parameters if p.role == "moment" and p.name in term.node)
    values = np.unique([node[name] for node in term.candidate.grid])
    here = int(np.argmin(np.abs(values - term.node[name])))
    around = values[max(here - AROUND, 0) : here + AROUND + 1]
    nodes = [{**term.node, name: float(value)} for value in around]
    found = solved_nodes(rest, term.candidate, joint_products(rest, term.candidate.joint), nodes).delta_chi2
    likely = around[found >= found.max() - ONE_IN_TWENTY * dispersion]
    return float(likely.min()), float(likely.max())


def _seen(fit: Fit, term: Term, columns: Floats) -> tuple[Floats, Floats]:
    """(whitened columns (m, r) with all that the fit has free taken out, their leaning (p + c, r) on that), of columns
    (n, a, r) as weights are.
    """
    u = (fit.W @ fit.arms.directions(term.candidate.joint) @ columns)[fit.used]
    leaning = cho_solve((fit.half, False), fit.X.onto(u))
    return (u - fit.X.at(leaning)).reshape(-1, columns.shape[2]), leaning


def _slope(term: Term, p: Parameter, theta: Floats) -> Floats:
    """(n, a) change of what a term does with a parameter; of a term whose size is the parameter, of its weights."""
    value = term.node[p.name]
    step = SMALL if p.role == "even" else SMALL * value
    high, low = (term.candidate.weights({**term.node, p.name: value + sign * step}) for sign in (1, -1))
    return (high - low) @ (theta if _is_linear(term.candidate) else np.ones(1)) / (2 * step)


def _least(loss: Callable[[float], float], start: float, grid: list[float], p: Parameter) -> float:
    """The value of a parameter at which loss is least, from a value of its grid on, within the parameter's bounds."""
    values = np.unique(grid)
    to, back = (np.log, np.exp) if p.role != "even" else (float, float)
    step = float(np.diff([to(v) for v in values]).max()) if len(values) > 1 else np.log(2.0)
    ends = [
        to(b) if (np.isfinite(b) and (b > 0 or p.role == "even")) else sign * np.inf
        for b, sign in zip(p.bounds, (-1, 1))
    ]
    here, least = to(start), loss(start)
    for _ in range(MOVES):
        low, high = max(here - step, ends[0]), min(here + step, ends[1])
        found = scipy.optimize.minimize_scalar(
            lambda x: loss(float(back(x))), bounds=(low, high), method="bounded", options={"xatol": CLOSE * step}
        )
        if not found.fun < least:
            break
        here, least = float(found.x), float(found.fun)
        if min(here - low, high - here) > 0.02 * step:
            break
    return float(back(here))
