"""Optimisation of the parameters of findings, and the parameters' intervals.

Findings are at an arm's joints.

Intervals allow for how residuals scatter and for what thermometers leave open; nonlinear parameters are optimised
between grid values.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import cho_solve

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Node
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Z95
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    normal_equations_by_direction_weights,
    solve_with_prior,
)
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.problems.arm.arm_candidate_chi_square_scores import (
    joint_motion_normal_equations_by_frame,
    solve_candidate_at_nodes,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    SPAN,
    Form,
    JointCandidate,
    joint_candidate,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import Arms
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, Term
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    Value,
    onset_time_with_interval,
    value_with_interval_cut_at_bounds,
)
from rig.array_and_json_types import Floats
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.model import machine_motion_simulation as motion_simulation
from rig.recording.recording_folder import Sensors

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
    """Whether a term has nonlinear continuous parameters.

    A sinusoid has none: the search refines its order.
    """
    return term.candidate.form is not Form.SINUSOID and bool(_continuous_parameters(term))


def optimise_nonlinear_parameters(fit_without_term: Fit, term: Term) -> Term:
    """Optimise a term's nonlinear parameters on the residuals of a Fit without it.

    Returns the term
    """
    products = joint_motion_normal_equations_by_frame(fit_without_term, term.candidate.joint)

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
    """Covariance of the parameters of one term (TermCovariance).

    They are its linear coefficients and nonlinear parameters together.
    """
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
    """Interval (earliest, latest) s in which the onset of a term may lie.
    dispersion : that its score allows for
    """
    term, rest = fit.terms[number], fit.without_terms([number])
    name = next(p.name for p in term.candidate.kind.parameters if p.role == "moment" and p.name in term.node)
    values = np.unique([node[name] for node in term.candidate.grid])
    here = int(np.argmin(np.abs(values - term.node[name])))
    around = values[max(here - AROUND, 0) : here + AROUND + 1]
    nodes = [{**term.node, name: float(value)} for value in around]
    found = solve_candidate_at_nodes(
        rest, term.candidate, joint_motion_normal_equations_by_frame(rest, term.candidate.joint), nodes
    ).delta_chi2
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


ORDER_STEP = 1e-4  # step of an order, for its derivative


def finding_parameters(
    fit: Fit, finding: Finding[JointCandidate], origin: TimeOrigin, added_covariance: Floats
) -> dict[str, Value]:
    """Parameters {name: Value} of a finding of a Fit, with intervals.

    origin : of the clock that tells moments; added_covariance : (c, c) covariance of the sizes by what the fit took to
        be exact
    """
    number = finding.number
    one, theta = fit.terms[number], fit.theta[fit.slices[number]]
    candidate = one.candidate
    if candidate.form is Form.SINUSOID:
        return _cycle(fit, finding, theta)
    joint = term_parameter_covariance(fit, number)
    covariance = joint.covariance[: len(theta), : len(theta)] * finding.score.dispersion + added_covariance
    bounds = {p.name: p.bounds for p in candidate.kind.parameters_at(candidate.place)}
    units = {p.name: p.unit for p in candidate.kind.parameters_at(candidate.place)}
    sigma = Z95 * np.sqrt(np.diag(covariance))
    effect = candidate.effect(one.node, theta)
    spec = next(s for s in candidate.specs if len(s.linear) == len(theta) or not s.linear)
    unit = axis_unit(fit, candidate.joint)
    if len(theta) > 1:  # a curve, or a load's moments: what it comes to first, then the numbers
        name = spec.linear[0].name
        level = theta - theta.mean() if candidate.form is Form.PROFILE else theta
        out = {
            "rms": _rms(fit, number, covariance, unit),
            name: Value(
                level.tolist(), units[name].split(", ")[0], [(level - sigma).tolist(), (level + sigma).tolist()]
            ),
        }
        return out | ({SPAN: Value(list(one.node[SPAN]), unit)} if SPAN in one.node else {})
    name = spec.linear[0].name if spec.linear else candidate.sought
    roles = {p.name: p.role for p in effect.parameters}
    value, low, high = (
        (1 / c if c > 0 else np.inf for c in (theta[0], theta[0] + sigma[0], theta[0] - sigma[0]))
        if roles[name] == "inverse"
        else (theta[0], theta[0] - sigma[0], theta[0] + sigma[0])
    )
    out = {name: value_with_interval_cut_at_bounds(float(value), units[name], (float(low), float(high)), bounds[name])}
    spreads = Z95 * np.sqrt(np.diag(joint.covariance)[len(theta) :] * finding.score.dispersion)
    spread = {n: float(s) for n, s in zip(joint.names, spreads)}
    return out | {
        key: onset_time_with_interval(fit.arms.t, v, origin, onset_time_interval(fit, number, finding.score.dispersion))
        if roles[key] == "moment"
        else value_with_interval_cut_at_bounds(v, units[key], (v - spread[key], v + spread[key]), bounds[key])
        if key in spread
        else Value(v, units[key])
        for key, v in one.node.items()
        if key in units and key != name
    }


def axis_unit(fit: Fit, joint: int | None) -> str:
    """Unit, "m" or "rad", of a joint's travel.

    The joint is given by its index.
    Where no one joint is meant, "rad".
    """
    return "rad" if joint is None else fit.arms.context.moved().units[joint]


def _rms(fit: Fit, number: int, covariance: Floats, unit: str) -> Value:
    """The RMS of what a term does to its joint, with an interval to first order: of that which the geometry cannot do
    as well, by the poses that it leaves. The rest is known as badly as the geometry, and none of the term's.
    """
    one, theta = fit.terms[number], fit.theta[fit.slices[number]]
    if one.candidate.joint is None:  # it moves the tool
        moved, w = fit.part(number), one.weights[:, 0] - one.weights[:, 0].mean(axis=0)
        value, squares = float(moved.std()), w.T @ w / len(w)
    else:
        left = _seen(fit.without_terms(range(len(fit.terms))), one, one.weights)[0]
        squares = left.T @ left / ((fit.W @ fit.arms.directions(one.candidate.joint))[fit.used] ** 2).sum()
        value = float(np.sqrt(theta @ squares @ theta))
    slope = squares @ theta / max(value, 1e-300)
    sigma = float(np.sqrt(max(slope @ covariance @ slope, 0)))
    return Value(value, unit, [max(value - Z95 * sigma, 0.0), value + Z95 * sigma])


def _cycle(fit: Fit, finding: Finding[JointCandidate], theta: Floats) -> dict[str, Value]:
    """amplitude, phase and order of a sinusoid, their joint covariance with all else free."""
    number = finding.number
    one = fit.terms[number]
    candidate, name = one.candidate, one.candidate.sought
    order = one.node[name]
    slope = (
        (candidate.weights({name: order + ORDER_STEP}) - candidate.weights({name: order - ORDER_STEP}))
        @ theta
        / (2 * ORDER_STEP)
    )
    used = fit.used
    u = (fit.W @ fit.arms.directions(candidate.joint) @ slope[..., None])[..., 0][used]
    leaning = cho_solve((fit.half, False), fit.X.onto(u[..., None])[:, 0])
    rest = u - fit.X.at(leaning[:, None])[..., 0]
    variance = finding.score.dispersion / max((rest**2).sum(), 1e-300)
    inverse = leaning[fit.slices[number]]  # how the sizes lean with the order
    covariance = fit.covariance(number) * finding.score.dispersion + variance * np.outer(inverse, inverse)
    amplitude = float(np.hypot(*theta))
    along = theta / max(amplitude, 1e-300)
    across = np.array([-along[1], along[0]])
    sigma = np.sqrt([along @ covariance @ along, across @ covariance @ across / amplitude**2, variance])
    values = (amplitude, float(np.arctan2(theta[1], theta[0])), order)
    return {
        key: Value(float(v), unit, [float(v - Z95 * s), float(v + Z95 * s)])
        for key, v, s, unit in zip(
            ("amplitude", "phase", name), values, sigma, (axis_unit(fit, candidate.joint), "rad", "")
        )
    }


def term_errors_by_temperature_logs(fit: Fit, term_number: int, log_errors: Mapping[str, Floats]) -> Floats:
    """Errors (c, q) of a term's sizes per standard deviation of the temperature logs' errors.

    log_errors : {channel: (rows, r)} of the log, as `smoothed_temperatures_and_errors` gives them
    """
    arms, sensors, here = fit.arms, fit.arms.context.sensors, fit.slices[term_number]
    none = np.zeros((here.stop - here.start, 0))
    if sensors is None or not log_errors:
        return none
    followed = {
        next((name for name in names if name in sensors.channels), "")
        for term in fit.terms
        for names in term.candidate.kind.follows(term.candidate.place, arms.context)
    }
    off = [none]
    for channel in sorted(followed & log_errors.keys()):
        for error in log_errors[channel].T:
            course = {**sensors.channels, channel: sensors.channels[channel] + error}
            off.append(_leaning(fit, _under(arms, replace(sensors, channels=course)))[here])
    return np.concatenate(off, axis=1)


def _under(arms: Arms, sensors: Sensors) -> Arms:
    """Arms with another log."""
    context = arms.context
    T = context.moved().T
    motion = motion_simulation.motion_of_commands(context.design, arms.commands, arms.t, (), sensors, T)
    return replace(arms, context=replace(context, sensors=sensors, motion=motion))


def _leaning(fit: Fit, other: Arms) -> Floats:
    """(p + c, 1) by which all sizes change for what the terms would do at other Arms."""
    seen = np.zeros((len(other), fit.left.shape[1], 1))
    for number, term in enumerate(fit.terms):
        change = joint_candidate(term.candidate.specs, other).weights(term.node) - term.weights
        seen += other.directions(term.candidate.joint) @ (change @ fit.theta[fit.slices[number]])[..., None]
    leaning: Floats = cho_solve((fit.half, False), fit.X.onto((fit.W @ seen)[fit.used]))
    return leaning
