"""What a calibration is worth, as words, tables and its page, in mm and mrad."""

import html
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.certify.calibration import Calibration
from calib.certify.held_out import Figures, HeldOut, errors_of
from calib.certify.claim import Claim
from calib.html_page import coverage, page, table
from calib.identify.observability import combinations
from calib.certify.verdict import verdict
from calib.correct.correction import Correction
from calib.correct.interpolate.radial import Radial
from calib.identify.geometry import Identified
from calib.samples import Samples
from calib.workspace.drawing import section
from rig import mechanisms
from rig.kinds import Struts
from rig.machine_file import GEOMETRY
from rig.pose import vector
from rig.recording import Recording


def calibration_page(path: Path | str, recording: Recording, calibration: Calibration, samples: Samples, found: Identified) -> None:
    """Write the page of a calibration: what it is worth, before and after on held-out poses, strut corrections, coverage, parameters."""
    correction = calibration.correction
    parts: list[str | Figure]
    parts = [*worth(calibration.claim), *_held(calibration.held_out),
             "<h2>Before and after, pose by pose</h2><p class=note>All poses; the fit has seen these.</p>",
             before_after(*errors_of(correction, samples), samples.frame),
             "<h2>What each strut is corrected by</h2><p class=note>Dots: x - IK(GDK(x)) at the visited configurations. Crosses: the correction "
             "at the same configurations.</p>", _corrections(correction, samples),
             "<h2>What the correction leaves</h2>", _left(samples, found), "<h2>Where the platform went</h2>",
             coverage(vector(samples.T_base_platform)), *section(calibration.workspace, "m"),
             "<h2>Parameters</h2>", _combinations(calibration, found), _parameters(calibration),
             "<h2>Where this came from</h2>", origin(calibration)]
    page(path, f"Calibration from {recording.name}", parts)


def worth(claim: Claim | None) -> list[str]:
    """HTML paragraphs of a Claim: the verdict, then on what it rests; none of a calibration that claims nothing."""
    if claim is None:
        return []
    first, *rest = verdict(claim)
    return [f"<p><b>{html.escape(first[0].upper() + first[1:])}.</b></p>",
            "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in rest) + "</ul>"]


def _held(held: HeldOut | None) -> list[str]:
    if held is None:
        return []
    rows = [("owner's model", *_figures(held.before)), ("corrected", *_figures(held.after))]
    return [f"<p>Held-out poses (whole stretches of configurations in turn, N = {held.after.n}, {held.configurations} distinct configurations): the "
            f"error falls from {held.before.position[0] * 1e3:.3f} mm to {held.after.position[0] * 1e3:.4f} mm RMS. The measured poses themselves "
            f"are uncertain by {held.floor[0] * 1e3:.4f} mm and {held.floor[1] * 1e3:.4f} mrad: what is left is "
            f"{held.after.position[0] / held.floor[0]:.2f} times that.</p>",
            table(("held-out pose error", "RMS, mm", "95 %, mm", "max, mm", "RMS, mrad", "95 %, mrad", "max, mrad"), rows)]


def _combinations(calibration: Calibration, found: Identified) -> str:
    """Every combination of the parameters with how well the poses tell it, folded."""
    parts, seen = combinations(found.root, calibration.correction.fitted)
    rows = [(part.name, f"{part.sigma * 1e6:.2f}" if part.sigma < 1e-2 else "not told") for part in parts]
    return (f"<details><summary>The {len(parts)} combinations that the poses tell, the worst first (condition number {seen.condition:.0f})</summary>"
            + table(("combination", "standard error by the poses alone, um"), rows) + "</details>")


def _figures(f: Figures) -> list[str]:
    return [f"{value * 1e3:.4f}" for value in (*f.position, *f.rotation)]


def before_after(before: np.ndarray, after: np.ndarray, frames: np.ndarray) -> Figure:
    """Figure of errors (n, 6) m and rad before and after correction, frame by frame; rotations that were not measured are nan and left out."""
    figure = Figure(figsize=(11, 3), layout="constrained")
    seen = [(part, label) for part, label in ((slice(0, 3), "position, mm"), (slice(3, 6), "rotation, mrad")) if np.isfinite(after[:, part]).all()]
    for axes, (part, label) in zip(np.ravel(figure.subplots(1, len(seen))), seen):
        for errors, name in ((before, "owner's model"), (after, "corrected")):
            axes.semilogy(frames, np.linalg.norm(errors[:, part], axis=1) * 1e3, ".", ms=4, label=name)
        axes.set(xlabel="frame", ylabel=label)
        axes.legend(fontsize=8)
    return figure


def _corrections(correction: Correction[Struts, Radial], samples: Samples) -> Figure:
    seen = samples.effective - mechanisms.of(correction.nominal).inverse(samples.T_base_platform, correction.nominal)
    modelled = correction.summand(samples.effective)
    figure = Figure(figsize=(11, 5), layout="constrained")
    for i, axes in enumerate(figure.subplots(2, seen.shape[1] // 2, squeeze=False).ravel()):
        order = np.argsort(samples.commanded[:, i])
        axes.plot(samples.commanded[:, i] * 1e3, seen[:, i] * 1e3, ".", ms=4)
        axes.plot(samples.commanded[order, i] * 1e3, modelled[order, i] * 1e3, "x", ms=3, alpha=0.6)
        axes.set(title=f"strut {i + 1}", xlabel="commanded, mm", ylabel="correction, mm")
    return figure


def _left(samples: Samples, found: Identified) -> Figure:
    figure = Figure(figsize=(11, 3), layout="constrained")
    axes = figure.subplots()
    sigma = np.sqrt(np.einsum("nii->ni", found.residual_covariance).mean())
    for i in range(found.residuals.shape[1]):
        axes.plot(samples.frame, found.residuals[:, i] * 1e6, ".", ms=3, label=f"strut {i + 1}")
    axes.axhspan(-2 * sigma * 1e6, 2 * sigma * 1e6, color="grey", alpha=0.2, label="2 sigma of a pose")
    axes.set(xlabel="frame", ylabel="strut, um")
    axes.legend(fontsize=7, ncols=7)
    return figure


def _parameters(calibration: Calibration) -> str:
    fitted, nominal = calibration.correction.fitted, calibration.correction.nominal
    sigma = np.sqrt(np.diag(calibration.covariance))
    rows, start = [], 0
    for name in GEOMETRY[nominal.kind]:
        for i, own in enumerate((getattr(fitted, name) - getattr(nominal, name)).reshape(len(nominal.axes), -1)):
            u = sigma[start : start + len(own)]
            rows.append((f"{name.replace('_', ' ')[:-1]} {i + 1}", *(f"{c * 1e3:+.4f} ± {2 * s * 1e3:.4f}" for c, s in zip(own, u)),
                         *[""] * (3 - len(own))))
            start += len(own)
    return table(("change from nominal, mm (k = 2)", "x or zero", "y", "z"), rows)


def origin(calibration: Calibration) -> str:
    """HTML of where a calibration came from; the marks of its data are for programs."""
    rows = {name: part for name, part in calibration.provenance.items() if name not in ("data", "passes")}
    before = {f"pass {k + 1}": {name: one[name] for name in ("recording", "created", "pass") if name in one}
              for k, one in enumerate(calibration.provenance.get("passes", ()))}
    return table(("what", "value"), flat(before | rows))


def flat(tree: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Rows (name, value) of a nested dict, for a table."""
    rows: list[tuple[str, Any]] = []
    for key, value in tree.items():
        name = f"{prefix}{key}"
        rows += flat(value, name + " / ") if isinstance(value, dict) else [(name, " ".join(map(str, value)) if isinstance(value, list) else value)]
    return rows
