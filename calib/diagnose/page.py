"""A diagnosis as a page that a rig's owner can act on: verdict, where, what it looks like, how sure, what else, what remains."""

import html

import numpy as np
from matplotlib.figure import Figure

from calib.diagnose.remedy import REMEDIES
from calib.diagnose.result import to_dict
from calib.diagnose.schematic import schematic
from calib.diagnose.telltale import over_time, residual_map, residuals, telltale
from calib.report import page, table

SCALES = {"m": (1e6, "µm"), "rad": (1e6, "µrad"), "1/K": (1e6, "10⁻⁶/K"), "N/m": (1e-6, "N/µm")}
FAR = 10.0  # standard deviations; a corner farther off counts for no more in the page's bars
LONG_TIME = 1000.0  # s; times from there on, and clocks, are written to a tenth of a second
LONG = 4  # numbers of a vector that are written out


def diagnosis_page(path, recording, diagnosis):
    """Write the page of a Diagnosis of a Recording: offline, one file, figures in micrometres and pixels."""
    tree = to_dict(diagnosis)
    settled = diagnosis.selection.settled
    k = settled.knowledge
    named = [f for f in tree["findings"] if f["effect"] != "unknown"]
    parts = [f"<p style='font-size:1.15em'><b>{_verdict(tree, named)}</b></p>", f"<p>{_held_out(tree['fit'], bool(named))}</p>"]
    if tree["findings"]:
        parts += ["<h2>Where</h2>", schematic(k, [f["place"] for f in tree["findings"]])]
    for number, finding in enumerate(named):
        parts += [f"<h2>{number + 1}. {_words(finding)}</h2>", *_finding(finding, diagnosis, number - len(diagnosis.swapped) - len(diagnosis.moved))]
    parts += ["<h2>What remains</h2>", *_remaining(diagnosis, tree)]
    parts += ["<h2>What was asked</h2>", _asked(diagnosis, tree), "<h2>The measurement</h2>", _measurement(recording, diagnosis, tree)]
    page(path, f"Diagnosis of {tree['recording']}", parts)


def _verdict(tree, named):
    worst = tree["unexplained"]
    left = ""
    if worst is not None:
        left = f"something at {worst['place']} that nothing in the catalogue explains, {_number(worst['magnitude'], worst['unit'])}"
        left += f", going with {' and '.join(worst['depends_on'])}" if worst["depends_on"] else ""
    if not named:
        text = f"There is {left}." if left else "Nothing is left out: the recording and the model of the rig agree within the noise."
        return html.escape(text)
    said = [f"{_words(f)}{_main(f)}" for f in named]
    text = "; ".join([*said, *([f"besides, {left}"] if left else [])])
    doubtful = [f["effect"].replace("_", " ") for f in named if f["cannot_be_told_from"]]
    text += f". This recording alone cannot tell the {' and the '.join(doubtful)} from everything else: see there" if doubtful else ""
    return html.escape(text[0].upper() + text[1:] + ".")


def _words(finding):
    return f"{finding['effect'].replace('_', ' ')} at {finding['place']}"


def _main(finding):
    """The first parameter in words; of a vector its length, of a profile its root mean square."""
    for name, p in finding["parameters"].items():
        value, unit = p["value"], p["unit"]
        if isinstance(value, (int, float)) and "ci95" in p:
            low, high = (_number(v, unit, False) for v in p["ci95"])
            return f", {name.replace('_', ' ')} {_number(value, unit)} (95 %: {low} to {high})"
        if name in ("motion", "offset") and len(value):
            thirds = np.reshape(np.asarray(value, float), (-1, 3))
            return ", by " + " and ".join(_number(np.linalg.norm(v), u) for v, u in zip(thirds, unit.split(", ")))
        if name == "profile" and len(value):
            return f", {_number(np.sqrt(np.mean(np.square(value))), unit)} RMS"
    return ""


def _number(value, unit, with_unit=True):
    scale, name = SCALES.get(unit, (1, unit))
    text = "unlimited" if not np.isfinite(value) else f"{value:.1f}" if unit == "s" and abs(value) >= LONG_TIME else f"{value * scale:.3g}"
    return f"{text} {name}".strip() if with_unit else text


def _held_out(fit, named):
    before, after, floor = (_number(fit[key], fit["unit"]) for key in ("heldout_before", "heldout_after", "noise_floor"))
    ratio = f", {fit['heldout_after'] / fit['noise_floor']:.2f} times the noise" if fit["noise_floor"] else ""
    if not named:
        return f"On stretches of the recording that the fit had not seen, {after} are left over{ratio} ({floor})."
    return (f"On stretches of the recording that the fit had not seen, the misfit falls from {before} to <b>{after}</b>{ratio} ({floor}).")


def _finding(finding, diagnosis, number):
    """Parts of one finding; number : of the selection's, negative for what was found before all else: faces exchanged or moved."""
    evidence, parts = finding["evidence"], []
    if number >= 0:
        admitted = diagnosis.selection.findings[number].number
        parts += [telltale(diagnosis.selection.settled, admitted),
                  "<p class=note>Dots are residuals, circles means of as many dots each with their 95 % interval. Without it: the best that cameras "
                  "and geometry can do alone; they swallow part of it.</p>"]
    parts.append(table(("parameter", "value", "95 % interval"), _parameters(finding)))
    if evidence:
        unit = evidence["unit"]
        parts.append("<p>How sure: " + "; ".join([
            f"held out, {_number(evidence['heldout_before'], unit)} without it and {_number(evidence['heldout_after'], unit)} with it"
            + (f" ({evidence['gain_sigma']:.1f} standard errors)" if np.isfinite(evidence.get("gain_sigma", np.nan)) else ""),
            f"chance of such a finding where there is nothing: {_chance(evidence['p_value'])}",
            f"information criterion better by {evidence['delta_bic']:.0f} (10 is convincing)"]) + ".</p>")
    parts.append(f"<p>What to do: {html.escape(REMEDIES[finding['effect']])}</p>")
    rivals = finding["cannot_be_told_from"]
    if rivals:
        parts += ["<p>What else it could be, for all that this recording says, and the experiment that would tell:</p>",
                  table(("effect", "place", "worse by", "experiment"),
                        [(r["effect"].replace("_", " "), r["place"], f"{r['delta_bic']:.1f}", r["experiment"]) for r in rivals])]
    elif number >= 0:
        parts.append("<p>Nothing else in the catalogue explains it as well.</p>")
    return parts


def _chance(p):
    return "below 1 in a million" if p < 1e-6 else f"1 in {1 / p:.0f}"


def _parameters(finding):
    rows = []
    for name, p in finding["parameters"].items():
        value, interval, unit = p["value"], p.get("ci95"), p["unit"]
        name = name.replace("_", " ")
        if isinstance(value, (int, float)):
            rows.append((name, _number(value, unit), f"{_number(interval[0], unit, False)} to {_number(interval[1], unit)}" if interval else ""))
            continue
        shown = [i for i, v in enumerate(value) if v][: 2 * LONG] if len(value) > LONG else range(len(value))
        units = unit.split(", ") if ", " in unit else [unit]
        for i in shown:
            own = units[i * len(units) // len(value)]
            rows.append((f"{name} {i + 1}", _number(value[i], own),
                         f"{_number(interval[0][i], own, False)} to {_number(interval[1][i], own)}" if interval else ""))
    return rows


def _remaining(diagnosis, tree):
    settled = diagnosis.selection.settled
    k = settled.knowledge
    struts, corners = residuals(settled)
    unknown = [f for f in tree["findings"] if f["effect"] == "unknown"]
    parts = [_levels(diagnosis, struts)]
    if not unknown:
        return [*parts, "<p>What remains looks like noise: no dependence on pose, time, history, image position or a logged channel was found.</p>"]
    rows = [(f["place"], _number(f["parameters"]["magnitude"]["value"], f["parameters"]["magnitude"]["unit"]),
             ", ".join(f["parameters"]["depends_on"]["value"]) or "scatters more than its noise", _chance(f["evidence"]["p_value"])) for f in unknown]
    parts += ["<p>Something remains that nothing in the catalogue explains. A smooth function fits it; it is given no name.</p>",
              table(("place", "size (RMS)", "goes with", "chance"), rows)]
    for f in unknown[:3]:
        kind, _, name = f["place"].partition(" ")
        if kind == "strut":
            parts += [f"<p class=note>{f['place']}</p>", over_time(k.t, struts[:, int(name) - 1] * 1e6, "strut, µm")]
        elif kind == "camera":
            own = np.flatnonzero(k.seen.observations.camera == [c.name for c in k.design.cameras].index(name))
            parts.append(residual_map(k, own, (corners,), ("what is left",)))
    return parts


def _levels(diagnosis, struts):
    """Figure of what is left of each strut and camera, with nothing admitted, with all, and the noise."""
    settled, before = diagnosis.selection.settled, diagnosis.selection.before
    k = settled.knowledge
    bare, _ = residuals(type(settled)(before.knowledge, before, [], np.zeros(0), np.zeros((0, 0)), None))
    rows = []
    if k.axes:
        inverse = np.linalg.inv(settled.planes.W)
        noise = np.sqrt(np.einsum("fij,fij->fi", inverse, inverse).mean(axis=0)) * 1e6
        kind = "joint" if k.design.mechanism.kind == "arm" else "strut"
        rows.append(([f"{kind} {i + 1}" for i in range(k.axes)], _rms(bare) * 1e6, _rms(struts) * 1e6, noise, "µm" if kind == "strut" else "µrad"))
    if k.seen is not None:
        o = k.seen.observations
        present = np.unique(o.camera)
        sigma = settled.planes.sigma * np.sqrt(np.median(np.einsum("nii->n", o.covariance)) / 2)
        off = [np.clip(o.uv - at.pixels(), -FAR * sigma, FAR * sigma) for at in (before.knowledge, k)]
        rms = [np.array([np.sqrt(np.mean(v[o.camera == i] ** 2)) for i in present]) for v in off]
        rows.append(([k.design.cameras[i].name for i in present], *rms, np.full(len(present), sigma), "px"))
    figure = Figure(figsize=(11, 2.8), layout="constrained")
    for axes, (labels, first, last, noise, unit) in zip(figure.subplots(1, max(len(rows), 1), squeeze=False)[0], rows):
        at = np.arange(len(labels))
        axes.bar(at - 0.2, first, 0.4, color="tab:red", label="nothing admitted")
        axes.bar(at + 0.2, last, 0.4, color="tab:blue", label="as diagnosed")
        axes.plot(at, noise, "k_", ms=28, label="noise")
        axes.set(xticks=at, xticklabels=labels, ylabel=f"RMS, {unit}", ylim=(0, 1.25 * max(first.max(), last.max(), noise.max())))
        axes.legend(fontsize=8, ncols=3, loc="upper center")
    return figure


def _rms(values):
    return np.sqrt((values**2).mean(axis=0))


def _asked(diagnosis, tree):
    asked = f"<p>{diagnosis.selection.families} hypotheses, an effect at a place each, were held against the recording.</p>"
    if not tree["not_asked"]:
        return asked + "<p>The whole catalogue could be asked for.</p>"
    return asked + "<p>These could not be:</p>" + table(("effect", "why"), [(s["effect"].replace("_", " "), s["reason"]) for s in tree["not_asked"]])


def _measurement(recording, diagnosis, tree):
    k, noise = diagnosis.selection.settled.knowledge, tree["noise"]
    units = {"corner_px": ("corner, per axis", "px"), "pose_m": ("pose, position", "m"), "pose_rad": ("pose, rotation", "rad"),
             "strut_m": ("strut", "m")}
    rows = [("poses from", diagnosis.source), ("frames", f"{len(k.t)} of {len(recording.exposures.times()[0])}"),
            ("time", f"{np.ptp(k.t) / 60:.1f} min"), ("corners", len(k.seen.observations) if k.seen is not None else "none"),
            ("sensors", ", ".join(recording.sensors.channels) if recording.sensors is not None else "none")]
    rows += [(f"noise of a {units[key][0]}", _number(value, units[key][1])) for key, value in noise.items() if value is not None and key in units]
    return table(("what", "value"), rows)
