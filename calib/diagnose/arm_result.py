"""An arm's diagnosis as diagnosis.json, and its parameters with intervals that allow for how residuals scatter."""

import json

import numpy as np
from scipy.linalg import cho_solve

from calib.diagnose.joint_scan import reshaped
from calib.diagnose.result import SCHEMA, _places, experiment
from rig.pose import vector
from rig.files import write_text
from rig.writing import write_table

NEAR = 0.02  # rad; nearer angles than that share a joint's profile
Z95 = 1.959964
UNITS = {"scale_error": "", "backlash": "rad", "hysteresis": "", "warm_up": "rad", "missed_steps": "rad", "creep": "", "joint_clearance": "rad",
         "thermal_expansion": "1/K"}
NAMES = {"scale_error": "scale", "backlash": "gap", "hysteresis": "weight", "warm_up": "amplitude", "missed_steps": "jump", "creep": "fraction",
         "joint_clearance": "gap", "thermal_expansion": "coefficient"}
SHAPES = {"order": "", "range": "rad", "time_constant": "s", "time": "s"}


def to_dict(d):
    """The tree of diagnosis.json of an ArmDiagnosis."""
    found = [_finding(d, f) for f in d.findings]
    found += [{"effect": "unknown", "place": u.place, "parameters": {"magnitude": {"value": u.magnitude, "unit": u.unit},
                                                                     "depends_on": {"value": list(u.depends_on), "unit": ""}},
               "evidence": {"p_value": u.p_value, "drop": u.drop}, "cannot_be_told_from": []} for u in _places(d.unknown)]
    worst = d.unknown[0] if d.unknown else None
    return {"schema": SCHEMA, "recording": d.recording, "start_s": d.origin.shown(0.0), "noise": noise(d), "findings": found,
            "unexplained": None if worst is None else {"place": worst.place, "magnitude": worst.magnitude, "unit": worst.unit,
                                                       "depends_on": list(worst.depends_on)},
            "fit": {"heldout_before": mean(d.held[0].before), "heldout_after": mean(d.held[0].after), "noise_floor": floor(d), "unit": "m"},
            "held_out": [{"stretches": h.stretches, "before": figures(h.before), "after": figures(h.after), **reach(h),
                          "chosen": [list(n) for n in h.names]} for h in d.held],
            "repeats": None if d.repeats is None else {"pairs": d.repeats.pairs, "mean_m": d.repeats.mean, "rms_m": d.repeats.rms,
                                                       "mean_rad": d.repeats.mean_rad, "remainder_that_repeats": d.repeats.again},
            "set_aside": d.arms.frame[~d.fit.used].tolist(),
            "not_asked": [{"effect": s.effect, "reason": s.reason} for s in d.skipped]}


def floor(d):
    """m, mean position error that no model can be below: that of commands given twice or, without any, the instrument's own."""
    return noise(d)["pose_m"] if d.repeats is None else d.repeats.mean


def save(folder, d, recording):
    """Write diagnosis.json into a folder, and what it takes to draw the recording anew: arm.json (the arm as found),
    joints.csv (per frame, what was commanded and what the findings do to it) and the recording's own files."""
    write_text(folder / "diagnosis.json", json.dumps(to_dict(d), indent=1) + "\n")
    tree = {"base": vector(d.arm.base).tolist(), "tool": vector(d.arm.tool).tolist(),
            "rotations": d.arms.left.shape[1] == 6, "effects": [f"{t.family.name} at {t.family.place}" for t in d.fit.terms]}
    count = d.arms.q.shape[1]
    more, growth = np.zeros(d.arms.q.shape), np.zeros(len(d.arms))
    for number, one in enumerate(d.fit.terms):
        if one.family.joint is None:
            growth += d.fit.part(number)
        else:
            more[:, one.family.joint] += d.fit.part(number)
    tree["joints"] = (d.arm.rows + more.mean(axis=0)[:, None] * [1, 0, 0, 0, 0]).tolist()  # what is constant is a joint's zero
    more -= more.mean(axis=0)
    names = ("frame", *(f"q{j + 1}" for j in range(count)), *(f"e{j + 1}" for j in range(count)), "growth")
    write_text(folder / "arm.json", json.dumps(tree) + "\n")
    write_table(folder / "joints.csv", names, [",".join([str(frame), *(f"{x:.12f}" for x in (*q, *e)), f"{g:.6e}"])
                                               for frame, q, e, g in zip(d.arms.frame, d.arms.q, more, growth)])
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        if (recording.folder / name).exists():
            write_text(folder / name, (recording.folder / name).read_text(encoding="utf-8-sig"))


def mean(left):
    """m, mean position error of residuals (n, k)."""
    return float(np.linalg.norm(left[:, :3], axis=1).mean())


def figures(left):
    """{mean_m, rms_m, p95_m, max_m, n} of position errors and, where they were measured, the mean rotation error in rad."""
    size = np.linalg.norm(left[:, :3], axis=1)
    out = {"mean_m": float(size.mean()), "rms_m": float(np.sqrt((size**2).mean())), "p95_m": float(np.quantile(size, 0.95)),
           "max_m": float(size.max()), "n": len(size)}
    return out | ({"mean_rad": float(np.linalg.norm(left[:, 3:], axis=1).mean())} if left.shape[1] == 6 else {})


def reach(held):
    """{after_at_fitted_angles, after_beyond}: figures of held-out poses all of whose joints stood within NEAR of an angle that they were
    fitted at, and of the rest; None where there are none. No data tell a profile where its joint never stood."""
    near = held.far <= NEAR
    return {name: figures(held.after[rows]) if rows.any() else None for name, rows in (("after_at_fitted_angles", near), ("after_beyond", ~near))}


def noise(d):
    """{corner_px, pose_m, pose_rad, strut_m}: the instrument's own standard uncertainty of a position and rotation, by length."""
    own = d.arms.own
    length = [float(np.sqrt(np.trace(own[:, part, part], axis1=1, axis2=2).mean())) for part in (slice(0, 3), slice(3, 6))]
    return {"corner_px": None, "pose_m": length[0], "pose_rad": length[1] or None, "strut_m": None}


def parameters(d, finding):
    """{name: {"value", "unit", "ci95"}} of a finding; intervals allow for the dispersion seen."""
    fit, number = d.fit, finding.number
    one, theta = fit.terms[number], fit.theta[fit.slices[number]]
    covariance = fit.covariance(number) * finding.score.dispersion
    name = one.family.name
    if name == "cyclic_error":
        return _cycle(d, finding, theta)
    if name == "transmission_error":
        sigma = np.sqrt(np.diag(covariance))
        level = theta - theta.mean()
        moved = fit.part(number)
        return {"profile": {"value": level.tolist(), "unit": "rad", "ci95": [(level - Z95 * sigma).tolist(), (level + Z95 * sigma).tolist()]},
                "rms": _scaled(moved, theta, covariance, one.weights, "rad"),
                "span": {"value": [one.shape["low"], one.shape["high"]], "unit": "rad"}}
    if name == "compliance":
        sigma = np.sqrt(np.diag(covariance))
        names = d.arms.moments[one.family.joint][1]
        return {"deflection": _scaled(fit.part(number), theta, covariance, one.weights, "rad"),
                "moment_over_stiffness": {"value": theta.tolist(), "unit": "kg m/(N m/rad), masses kg/(N m/rad)",
                                          "ci95": [(theta - Z95 * sigma).tolist(), (theta + Z95 * sigma).tolist()]},
                "moments": {"value": list(names), "unit": ""}}
    sigma = float(np.sqrt(covariance[0, 0]))
    out = {NAMES[name]: {"value": float(theta[0]), "unit": UNITS[name], "ci95": [float(theta[0]) - Z95 * sigma, float(theta[0]) + Z95 * sigma]}}
    shape = one.shape | ({"time": d.origin.shown(one.shape["time"])} if "time" in one.shape else {})
    return out | {key: {"value": shape[key], "unit": unit} for key, unit in SHAPES.items() if key in shape}


def _scaled(moved, theta, covariance, weights, unit):
    """The RMS, about its mean, of what a term does to its joint, with an interval to first order."""
    w = weights - weights.mean(axis=0)
    value = float((moved - moved.mean()).std())
    slope = w.T @ (w @ theta) / len(w) / max(value, 1e-300)
    sigma = float(np.sqrt(max(slope @ covariance @ slope, 0)))
    return {"value": value, "unit": unit, "ci95": [max(value - Z95 * sigma, 0.0), value + Z95 * sigma]}


def _cycle(d, finding, theta):
    """amplitude, phase and order of a sinusoid, their joint covariance with all else free."""
    fit, number = d.fit, finding.number
    one = fit.terms[number]
    order, small = one.shape["order"], 1e-4
    slope = (reshaped(one, order=order + small).weights - reshaped(one, order=order - small).weights) @ theta / (2 * small)
    used = fit.used
    direction = d.arms.joints[..., one.family.joint] * slope[:, None]
    u = (fit.W @ direction[..., None])[..., 0][used]
    leaning = cho_solve((fit.half, False), fit.X[used].reshape(u.size, -1).T @ u.ravel())
    rest = u - (fit.X @ leaning)[used]
    variance = finding.score.dispersion / max((rest**2).sum(), 1e-300)
    inverse = leaning[fit.slices[number]]  # how the sizes lean with the order
    covariance = fit.covariance(number) * finding.score.dispersion + variance * np.outer(inverse, inverse)
    amplitude = float(np.hypot(*theta))
    along = theta / max(amplitude, 1e-300)
    sigma = np.sqrt([along @ covariance @ along, np.array([-along[1], along[0]]) @ covariance @ np.array([-along[1], along[0]]) / amplitude**2,
                     variance])
    values = (amplitude, float(np.arctan2(theta[1], theta[0])), order)
    return {name: {"value": float(v), "unit": unit, "ci95": [float(v - Z95 * s), float(v + Z95 * s)]}
            for name, v, s, unit in zip(("amplitude", "phase", "order"), values, sigma, ("rad", "rad", ""))}


def _finding(d, finding):
    family = d.fit.terms[finding.number].family
    rivals = [_rival(family.name, r) for r in finding.rivals]
    return {"effect": family.name, "place": family.place, "parameters": parameters(d, finding),
            "evidence": {"delta_bic": finding.score.gain(d.fit.size), "p_value": min(1.0, finding.score.p_value * d.families),
                         "heldout_before": finding.before, "heldout_after": finding.after, "unit": "m", "gain_sigma": finding.gain},
            "cannot_be_told_from": rivals}


def _rival(name, rival):
    family, shape = rival.score.family, rival.score.shape
    order = {"order": shape["order"]} if "order" in shape else {}
    return {"effect": family.name, "place": family.place, "delta_bic": rival.behind, "cosine": rival.cosine, **order,
            "experiment": experiment(name, family.name)}
