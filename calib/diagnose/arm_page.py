"""The page of an arm's diagnosis: verdict, errors before and after, and each effect against what it depends on."""

import html

import numpy as np
from matplotlib.figure import Figure

from calib.diagnose.arm_picture import picture
from calib.report import page, table

SURE = ("effect", "place", "size", "delta BIC", "held-out RMS without it, mm", "with it", "cannot be told from")
HELP = {"transmission_error": "the joint's own angle", "cyclic_error": "the joint's own angle", "scale_error": "the joint's own angle"}


def diagnosis_page(path, d):
    """Write the page of an ArmDiagnosis."""
    from calib.diagnose.arm_result import NEAR, figures, noise, parameters

    def row(label, left):
        f = figures(left)
        return [label, *(f"{f[key] * 1e3:.4f}" for key in ("mean_m", "rms_m", "p95_m", "max_m")), f"{f.get('mean_rad', np.nan) * 1e3:.4f}", f["n"]]

    floor_text = (f"the instrument's own uncertainty is {noise(d)['pose_m'] * 1e3:.3f} mm" if d.repeats is None else
                  f"the same command given again comes back within {d.repeats.mean * 1e3:.3f} mm ({d.repeats.pairs} pairs)")
    names = ", ".join(sorted({f"{t.family.name} at {t.family.place}" for t in d.fit.terms}))
    held = d.held[0]
    before, after = figures(held.before)["mean_m"] * 1e3, figures(held.after)["mean_m"] * 1e3
    verdict = (f"Left out: <b>{html.escape(names)}</b>. On stretches neither fitted nor used to choose, the mean position error falls from "
               f"{before:.3f} mm (geometry alone) to <b>{after:.3f} mm</b>; {floor_text}."
               if d.fit.terms else "Nothing is left out: the recording and the geometry agree within the noise.")
    rows = [row(f"{label}, {h.stretches} stretches", left) for h in d.held
            for label, left in (("geometry alone", h.before), ("with effects", h.after), ("of these, every joint near angles it was fitted at",
                                h.after[h.far <= NEAR]), ("of these, a joint at angles never fitted", h.after[h.far > NEAR])) if len(left)]
    aside = d.arms.frame[~d.fit.used]
    parts = [f"<p>{verdict}</p>", f"<p>{len(aside)} poses agree with no model and were set aside: frames {', '.join(map(str, aside))}.</p>"
             if len(aside) else "", picture(d.arm, d.arms.q, _moved(d)),
             table(("held-out error", "mean, mm", "RMS", "95 %", "max", "mean, mrad", "N"), rows)]
    if d.findings:
        parts += ["<h2>How sure</h2>", table(SURE,
                  [_row(d, f, parameters(d, f)) for f in d.findings])]
        parts += ["<h2>What it looks like</h2><p class=note>Residual turned back into the joint, everything else taken out: grey with the effect "
                  "left in, blue with it taken out; red the effect as fitted.</p>", _effects(d)]
    parts += ["<h2>Pose by pose</h2>", _errors(held, None if d.repeats is None else d.repeats.mean)]
    if d.unknown:
        parts += ["<h2>What nobody can name</h2>", table(("place", "RMS", "depends on"),
                  [(u.place, f"{u.magnitude * 1e3:.4f} m{u.unit}", _depends(d, u)) for u in d.unknown])]
    parts += ["<h2>Not asked</h2>", table(("effect", "reason"), [(s.effect, s.reason) for s in d.skipped])]
    page(path, f"Diagnosis of {d.recording}", parts)


def _moved(d):
    """{joint: {effect: RMS in rad}} of what the findings do, those of one name at one joint together."""
    out = {}
    for number, term in enumerate(d.fit.terms):
        if term.family.joint is not None:
            here = out.setdefault(term.family.joint, {})
            here[term.family.name] = float(np.hypot(here.get(term.family.name, 0.0), d.fit.part(number).std()))
    return out


def _row(d, f, found):
    name, first = next(iter((k, v) for k, v in found.items() if k in ("rms", "deflection") or isinstance(v["value"], float)))
    low, high = first.get("ci95", (np.nan, np.nan))
    rivals = "; ".join(f"{r.score.family.name} at {r.score.family.place}" for r in f.rivals) or "-"
    family = d.fit.terms[f.number].family
    return (family.name, family.place, f"{name} {first['value']:.3g} {first['unit']} ({low:.3g} to {high:.3g})", f"{f.score.gain(d.fit.size):.0f}",
            f"{f.before * 1e3:.4f}", f"{f.after * 1e3:.4f}", rivals)


def _depends(d, u):
    if u.depends_on == ("configuration",):
        return f"the same command brings it again ({d.repeats.again:.0%} of it): no noise, and of no form that was tried"
    return ", ".join(u.depends_on) or "scatter beyond the instrument's"


def _effects(d):
    shown = d.findings[:18]
    figure = Figure(figsize=(11, 2.6 * -(-len(shown) // 3)), layout="constrained")
    fit, arms = d.fit, d.arms
    for i, f in enumerate(shown):
        one = fit.terms[f.number]
        axes = figure.add_subplot(-(-len(shown) // 3), 3, i + 1)
        j, moved = one.family.joint, fit.part(f.number)
        direction = arms.lengths if j is None else arms.joints[..., j]
        a, y = (fit.W @ direction[..., None])[..., 0], fit.y
        rest = (a * y).sum(axis=1) / np.maximum((a * a).sum(axis=1), 1e-300)
        level = moved[fit.used].mean()
        x, label = (arms.q[:, j], "angle, rad") if one.family.name in HELP else ((moved - level) * 1e3, "predicted, mrad")
        if one.family.name in ("warm_up", "missed_steps"):
            x, label = arms.t, "time, s"
        good = np.flatnonzero(fit.used)[np.argsort(x[fit.used])]
        axes.plot(x[good], (rest + moved - level)[good] * 1e3, ".", ms=2, color="0.6")
        axes.plot(x[good], rest[good] * 1e3, ".", ms=1.5, color="tab:blue")
        axes.plot(x[good], (moved - level)[good] * 1e3, "-", lw=0.8, color="tab:red")
        size = 1.2 * np.quantile(np.abs((rest + moved - level)[good]), 0.99) * 1e3
        axes.set(title=f"{one.family.name}, {one.family.place}", xlabel=label, ylabel="mrad", ylim=(-size, size))
    return figure


def _errors(held, floor):
    figure = Figure(figsize=(11, 3), layout="constrained")
    axes = figure.subplots()
    for left, label in ((held.before, "geometry alone"), (held.after, "with effects")):
        axes.semilogy(np.linalg.norm(left[:, :3], axis=1) * 1e3, ".", ms=2, label=label)
    if floor is not None:
        axes.axhline(floor * 1e3, color="0.3", lw=0.8, label="the same command again")
    axes.set(xlabel="pose", ylabel="held-out position error, mm")
    axes.legend(fontsize=8)
    return figure
