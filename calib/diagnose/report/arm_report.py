"""Report of an arm's diagnosis, with intervals that allow for the residuals' scatter."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cho_solve

from calib.diagnose.engine.chance_probability import Z95
from calib.diagnose.engine.cross_validation import CrossValidation
from calib.diagnose.engine.term_selection import Finding
from calib.diagnose.problems.arm.arm_diagnosis import ArmDiagnosis, HeldOutPoses
from calib.diagnose.problems.arm.joint_candidates import SPAN, Form
from calib.diagnose.problems.arm.nonlinear_parameters import onset_time_interval, term_parameter_covariance
from calib.diagnose.problems.arm.pose_fit import Term
from calib.diagnose.report import finding_contributions
from calib.diagnose.report.diagnosis_json import (
    ASSUMED_NOISE,
    STATED,
    AlternativeEntry,
    Evidence,
    FindingEntry,
    FitEntry,
    NotAskedEntry,
    Unexplained,
    Value,
    bounded_value,
    covariate_entries,
    effects_files,
    recording_entries,
    stated_beforehand,
    suggestion_entries,
)
from calib.diagnose.report.diagnosis_report import Report
from calib.diagnose.report.diagnosis_verdict import write_diagnosis_json
from calib.diagnose.report.platform_report import (
    copy_recording,
    largest_unexplained,
    moment_text,
    separating_experiment_text,
    unnamed_finding_entries,
    unusual_size_reason,
)
from calib.models.arm.held_out_scatter import UNSTATED
from rig.formats import machine_json
from rig.formats.output_files import write_text
from rig.model import mechanisms
from rig.recording.recording_folder import Recording

SAME_ANGLE = 0.02  # rad; nearer angles than that share a joint's profile
SMALL = 1e-4  # step of an order, for its derivative


def arm_report(diagnosis: ArmDiagnosis) -> Report:
    """Report of an arm's diagnosis."""
    found = [_finding(diagnosis, f, proof) for f, proof in zip(diagnosis.findings, diagnosis.cross_validations)]
    fit = FitEntry(
        _mean_position_error(diagnosis.held[0].before),
        _mean_position_error(diagnosis.held[0].after),
        _position_error_floor(diagnosis),
        "m",
    )
    held = [
        {
            "stretches": h.stretches,
            "before": residual_statistics(h.before),
            "after": residual_statistics(h.after),
            **_extrapolation_figures(h),
            "chosen": [list(n) for n in h.names],
        }
        for h in diagnosis.held
    ]
    again = (
        None
        if diagnosis.repeats is None
        else {
            "pairs": diagnosis.repeats.pairs,
            "mean_m": diagnosis.repeats.mean,
            "rms_m": diagnosis.repeats.rms,
            "mean_rad": diagnosis.repeats.mean_rad,
            "remainder_that_repeats": diagnosis.repeats.recurring_share,
        }
    )
    return Report(
        diagnosis.recording,
        diagnosis.origin.shown(0.0),
        _instrument_noise(diagnosis),
        (*found, *unnamed_finding_entries(diagnosis.left)),
        largest_unexplained(diagnosis.left) or _excess_position_scatter(diagnosis),
        {"poses": fit},
        fit,
        tuple(NotAskedEntry(s.effect, s.reason) for s in diagnosis.not_asked),
        covariates=covariate_entries(diagnosis.covariates),
        said=diagnosis.said,
        recordings=recording_entries(diagnosis.parts),
        own_effects=effects_files(diagnosis.own),
        suggestions=suggestion_entries(diagnosis.suggestions),
        more={
            "scatter_beyond_stated_m": float(np.sqrt(3) * diagnosis.fit.scatter[0]),
            "held_out": held,
            "held_out_by_region": _held_out_region_gains(diagnosis),
            "repeats": again,
            "set_aside": diagnosis.arms.frame[diagnosis.fit.aside].tolist(),
        },
        confounds=diagnosis.confounds,
        noise_from=ASSUMED_NOISE if diagnosis.arms.assumed else STATED,
        left_out=diagnosis.left_out,
        crowd=diagnosis.crowd,
    )


def _excess_position_scatter(d: ArmDiagnosis) -> Unexplained | None:
    """What positions scatter beyond what is stated for them, by length, where that and what is stated exceed the stated
    UNSTATED times.
    """
    beyond, stated = float(np.sqrt(3) * d.fit.scatter[0]), _by_length(d.arms.own, slice(0, 3))
    return Unexplained("rig", beyond, "m", ()) if np.hypot(beyond, stated) > UNSTATED * stated else None


def _held_out_region_gains(d: ArmDiagnosis) -> list[dict[str, Any]]:
    """For each joint, what each finding brings where whole regions of its travel are held out: misfit before and after,
    m, and standard errors.
    """
    places = mechanisms.axis_places(d.arm)
    return [
        {
            "joint": j + 1,
            "place": places[j],
            "findings": [{"heldout_before": v.before, "heldout_after": v.after, "gain_sigma": v.gain} for v in row],
        }
        for j, row in enumerate(d.regions)
    ]


def _position_error_floor(d: ArmDiagnosis) -> float:
    """m, mean position error that no model can be below: that of commands given twice or, without any, the instrument's
    own.
    """
    return _by_length(d.arms.own, slice(0, 3)) if d.repeats is None else d.repeats.mean


def _mean_position_error(left: np.ndarray) -> float:
    """m, mean position error of residuals (n, k)."""
    return float(np.linalg.norm(left[:, :3], axis=1).mean())


def residual_statistics(left: np.ndarray) -> dict[str, float]:
    """{mean_m, rms_m, p95_m, max_m, n} of position errors in m and, where measured, the mean rotation error in rad."""
    size = np.linalg.norm(left[:, :3], axis=1)
    out = {
        "mean_m": float(size.mean()),
        "rms_m": float(np.sqrt((size**2).mean())),
        "p95_m": float(np.quantile(size, 0.95)),
        "max_m": float(size.max()),
        "n": len(size),
    }
    return out | ({"mean_rad": float(np.linalg.norm(left[:, 3:], axis=1).mean())} if left.shape[1] == 6 else {})


def _extrapolation_figures(held: HeldOutPoses) -> dict[str, Any]:
    """{after_at_fitted_angles, after_beyond}: figures of held-out poses all of whose joints stood within SAME_ANGLE of
    an angle that they were fitted at, and of the rest; None where there are none. No data tell a profile where its
    joint never stood."""
    near = held.far <= SAME_ANGLE
    return {
        name: residual_statistics(held.after[rows]) if rows.any() else None
        for name, rows in (("after_at_fitted_angles", near), ("after_beyond", ~near))
    }


def _instrument_noise(d: ArmDiagnosis) -> dict[str, float | None]:
    """{corner_px, pose_m, pose_rad, strut_m}: the instrument's own standard uncertainty of a position and rotation, by
    length.
    """
    own = d.arms.own
    return {
        "corner_px": None,
        "pose_m": _by_length(own, slice(0, 3)),
        "pose_rad": _by_length(own, slice(3, 6)) or None,
        "strut_m": None,
    }


def _by_length(own: np.ndarray, part: slice) -> float:
    """Standard uncertainty by length, of part of what was measured with covariances (n, k, k)."""
    return float(np.sqrt(np.trace(own[:, part, part], axis1=1, axis2=2).mean()))


def _finding_parameters(d: ArmDiagnosis, finding: Finding) -> dict[str, Value]:
    """{name: Value} of a finding; intervals allow for the dispersion seen."""
    fit, number = d.fit, finding.number
    one, theta = fit.terms[number], fit.theta[fit.slices[number]]
    candidate = one.candidate
    if candidate.form is Form.SINUSOID:
        return _cycle(d, finding, theta)
    joint = term_parameter_covariance(fit, number)
    covariance = joint.covariance[: len(theta), : len(theta)] * finding.score.dispersion
    bounds = {p.name: p.bounds for p in candidate.kind.parameters_at(candidate.place)}
    units = {p.name: p.unit for p in candidate.kind.parameters_at(candidate.place)}
    sigma = Z95 * np.sqrt(np.diag(covariance))
    effect = candidate.effect(one.node, theta)
    spec = next(s for s in candidate.specs if len(s.linear) == len(theta) or not s.linear)
    unit = _unit_at(d, candidate.joint)
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
        key: moment_text(d.arms.t, v, d.origin, onset_time_interval(fit, number, finding.score.dispersion))
        if roles[key] == "moment"
        else bounded_value(v, units[key], (v - spread[key], v + spread[key]), bounds[key])
        if key in spread
        else Value(v, units[key])
        for key, v in one.node.items()
        if key in units and key != name
    }


def _unit_at(d: ArmDiagnosis, joint: int | None) -> str:
    """Unit, "m" or "rad", of the travel of a joint, by its index; of no one joint's "rad"."""
    return "rad" if joint is None else mechanisms.axis_units(d.arm)[joint]


def _scaled(moved: np.ndarray, theta: np.ndarray, covariance: np.ndarray, one: Term, unit: str) -> Value:
    """The RMS, about its mean, of what a term does to its joint, with an interval to first order."""
    w = one.weights[:, 0] - one.weights[:, 0].mean(axis=0)
    value = float((moved - moved.mean()).std())
    slope = w.T @ (w @ theta) / len(w) / max(value, 1e-300)
    sigma = float(np.sqrt(max(slope @ covariance @ slope, 0)))
    return Value(value, unit, [max(value - Z95 * sigma, 0.0), value + Z95 * sigma])


def _cycle(d: ArmDiagnosis, finding: Finding, theta: np.ndarray) -> dict[str, Value]:
    """amplitude, phase and order of a sinusoid, their joint covariance with all else free."""
    fit, number = d.fit, finding.number
    one = fit.terms[number]
    candidate, name = one.candidate, one.candidate.sought
    order = one.node[name]
    slope = (candidate.weights({name: order + SMALL}) - candidate.weights({name: order - SMALL})) @ theta / (2 * SMALL)
    used = fit.used
    u = (fit.W @ d.arms.directions(candidate.joint) @ slope[..., None])[..., 0][used]
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
            ("amplitude", "phase", name), values, sigma, (_unit_at(d, candidate.joint), "rad", "")
        )
    }


def _finding(d: ArmDiagnosis, finding: Finding, proof: CrossValidation) -> FindingEntry:
    candidate, score = d.fit.terms[finding.number].candidate, finding.score
    others = tuple(
        AlternativeEntry(
            other.name,
            other.place,
            a.behind,
            a.cosine,
            separating_experiment_text((candidate.kind, candidate.place), (other.kind, other.place)),
            a.score.node.get("order"),
        )
        for a, other in ((a, a.score.candidate) for a in finding.alternatives)
    )
    evidence = Evidence(
        score.delta_bic(d.fit.size),
        min(1.0, score.p_value * d.asked),
        proof.before,
        proof.after,
        proof.unit,
        proof.gain,
    )
    found = _finding_parameters(d, finding)
    return FindingEntry(
        candidate.name,
        candidate.place,
        found,
        evidence,
        others,
        candidate.kind.action_at(candidate.place),
        stated_beforehand(d.given, candidate.name, candidate.place),
        unusual_size_reason(candidate.kind, candidate.place, found),
    )


def write_arm_diagnosis(folder: Path, diagnosis: ArmDiagnosis, recording: Recording, report: Report) -> None:
    """Write diagnosis.json into a folder, and what it takes to simulate the arm as found: machine.json and the
    recording's own rig.toml, commands, frames and sensors.
    report : Report of d"""
    write_diagnosis_json(folder, report)
    found = replace(recording.design, mechanism=diagnosis.arm)
    write_text(folder / "machine.json", json.dumps(machine_json.machine_dict(found, diagnosis.effects)) + "\n")
    copy_recording(folder, recording)
    finding_contributions.write_contributions(folder / "contributions.csv", diagnosis)
