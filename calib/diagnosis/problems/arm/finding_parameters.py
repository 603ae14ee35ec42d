"""Parameters of what was found at an arm's joints, with intervals that allow for how residuals scatter and for what
thermometers leave open.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_solve

from calib.diagnosis.engine.cross_validation_and_chance import Z95
from calib.diagnosis.engine.finding_confirmation_against_alternatives import Finding
from calib.diagnosis.problems.arm.joint_candidates import SPAN, Form, JointCandidate, joint_candidate
from calib.diagnosis.problems.arm.linearised_poses import Arms
from calib.diagnosis.problems.arm.nonlinear_parameters import onset_time_interval, term_parameter_covariance
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit, Term
from calib.diagnosis.problems.evidence_interface import Value, bounded_value, onset_time_value
from rig.array_and_json_types import Floats
from rig.model import motion_simulation
from rig.recording.recording_folder import Sensors
from rig.recording.time_origin import TimeOrigin

SMALL = 1e-4  # step of an order, for its derivative


def finding_parameters(
    fit: Fit, finding: Finding[JointCandidate], origin: TimeOrigin, added_covariance: Floats
) -> dict[str, Value]:
    """{name: Value} of a finding of a Fit; intervals allow for the dispersion seen.

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
            "rms": _scaled(fit.part(number), theta, covariance, one, unit),
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
    out = {name: bounded_value(float(value), units[name], (float(low), float(high)), bounds[name])}
    spreads = Z95 * np.sqrt(np.diag(joint.covariance)[len(theta) :] * finding.score.dispersion)
    spread = {n: float(s) for n, s in zip(joint.names, spreads)}
    return out | {
        key: onset_time_value(fit.arms.t, v, origin, onset_time_interval(fit, number, finding.score.dispersion))
        if roles[key] == "moment"
        else bounded_value(v, units[key], (v - spread[key], v + spread[key]), bounds[key])
        if key in spread
        else Value(v, units[key])
        for key, v in one.node.items()
        if key in units and key != name
    }


def axis_unit(fit: Fit, joint: int | None) -> str:
    """Unit, "m" or "rad", of the travel of a joint, by its index; of no one joint's "rad"."""
    return "rad" if joint is None else fit.arms.context.moved().units[joint]


def _scaled(moved: Floats, theta: Floats, covariance: Floats, one: Term, unit: str) -> Value:
    """The RMS, about its mean, of what a term does to its joint, with an interval to first order."""
    w = one.weights[:, 0] - one.weights[:, 0].mean(axis=0)
    value = float((moved - moved.mean()).std())
    slope = w.T @ (w @ theta) / len(w) / max(value, 1e-300)
    sigma = float(np.sqrt(max(slope @ covariance @ slope, 0)))
    return Value(value, unit, [max(value - Z95 * sigma, 0.0), value + Z95 * sigma])


def _cycle(fit: Fit, finding: Finding[JointCandidate], theta: Floats) -> dict[str, Value]:
    """amplitude, phase and order of a sinusoid, their joint covariance with all else free."""
    number = finding.number
    one = fit.terms[number]
    candidate, name = one.candidate, one.candidate.sought
    order = one.node[name]
    slope = (candidate.weights({name: order + SMALL}) - candidate.weights({name: order - SMALL})) @ theta / (2 * SMALL)
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

    log_errors : {channel: (rows, r)} of the log, as `smooth_temperatures` gives them
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
    motion = motion_simulation.motion_of_commands(context.design, arms.commands, arms.t, (), sensors)
    moved = replace(motion, T=context.moved().T)
    return replace(arms, context=replace(context, sensors=sensors, motion=moved))


def _leaning(fit: Fit, other: Arms) -> Floats:
    """(p + c, 1) by which all sizes change for what the terms would do at other Arms."""
    seen = np.zeros((len(other), fit.left.shape[1], 1))
    for number, term in enumerate(fit.terms):
        change = joint_candidate(term.candidate.specs, other).weights(term.node) - term.weights
        seen += other.directions(term.candidate.joint) @ (change @ fit.theta[fit.slices[number]])[..., None]
    leaning: Floats = cho_solve((fit.half, False), fit.X.onto((fit.W @ seen)[fit.used]))
    return leaning
