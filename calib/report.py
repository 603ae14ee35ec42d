"""Pages that a rig's owner can read offline: figures in one self-contained HTML file, in mm and mrad."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.certify.calibration import Calibration
from calib.certify.held_out import Figures, HeldOut, errors_of
from calib.certify.claim import Claim
from calib.identify.observability import combinations
from calib.certify.verdict import verdict
from calib.correct.correction import Correction
from calib.correct.interpolate.radial import Radial
from calib.identify.geometry import Identified
from calib.picture import picture
from calib.samples import Samples
from calib.workspace.drawing import section
from rig import mechanisms
from rig.files import write_text
from rig.kinds import Struts
from rig.machine_file import GEOMETRY
from rig.pose import vector
from rig.recording import Recording
from vision.bundle.places import Places
from vision.measure import Measurement
from vision.reading.collect import Collected
from vision.reading.identity import Suspect

STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#1a1a1a}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}img{max-width:100%}table{border-collapse:collapse;margin:1em 0}
td,th{padding:.25em .8em;border-bottom:1px solid #ddd;text-align:right}td:first-child,th:first-child{text-align:left}
.note{color:#666;font-size:.9em}table{display:block;overflow-x:auto}
@media(prefers-color-scheme:dark){body{background:#161616;color:#e4e4e4}td,th{border-color:#444}.note{color:#aaa}img{background:#fff}}"""


def page(path: Path | str, title: str, parts: Sequence[str | Figure]) -> None:
    """Write a self-contained HTML page. parts : strings of HTML and matplotlib Figures, in order."""
    body = "\n".join(picture(part) if isinstance(part, Figure) else part for part in parts)
    text = ('<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">'
            f'<meta name=color-scheme content="light dark"><title>{html.escape(title)}</title><style>{STYLE}</style>'
            f"<h1>{html.escape(title)}</h1>\n{body}\n</html>\n")
    write_text(path, text)


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """HTML of a table: header and rows of text."""
    def cells(row: Sequence[Any], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in row) + "</tr>"

    return "<table>" + cells(header, "th") + "".join(cells(row, "td") for row in rows) + "</table>"


def measurement_page(path: Path | str, recording: Recording, measurement: Measurement, collected: Collected | None, places: Places | None = None,
                     statement: Sequence[str] = (), suspects: Sequence[Suspect] = ()) -> None:
    """Write the page of a measurement: residual map of each camera, pose coverage, uncertainty, cameras, unsolved frames.

    places : vision Places where markers' places were adjusted, else None; statement : lines on what the recording determines
    suspects : of vision.reading.identity, markers that are not what rig.toml says
    """
    m = measurement
    total = len(recording.exposures.times()[0])
    rotation = np.sqrt(np.trace(m.covariance[:, 3:, 3:], axis1=1, axis2=2))
    position = np.sqrt(np.trace(m.covariance[:, :3, :3], axis1=1, axis2=2))
    parts: list[str | Figure]
    parts = [f"<p>{len(m.frames)} of {total} frames solved; {m.inliers.sum()} corners used, {(~m.inliers & np.isfinite(m.residuals[:, 0])).sum()} "
             f"set aside as outliers. A corner scatters by <b>{m.noise:.4f} px</b> per axis. A pose is uncertain by "
             f"{np.sqrt((position**2).mean()) * 1e6:.1f} &micro;m and {np.sqrt((rotation**2).mean()) * 1e6:.1f} &micro;rad "
             "(RMS standard uncertainty of its length, cameras' own uncertainty included).</p>",
             "<h2>What the cameras leave over</h2><p class=note>Mean residual over patches of the image, drawn enlarged; a pattern here is a lens "
             "that the model lacks.</p>", _residual_maps(m), "<h2>Where the platform went</h2>", coverage(vector(m.T_base_platform)),
             "<h2>How well each pose is known</h2>", _uncertainty(m, position, rotation), "<h2>Cameras</h2>", _cameras(recording, m)]
    if statement:
        parts += ["<h2>What this recording determines</h2><ul>", *(f"<li>{html.escape(line)}</li>" for line in statement), "</ul>"]
    if places is not None:
        parts += ["<h2>Where the markers really are</h2><p class=note>From their stated places, along their own x (right), y (up), z (out), with "
                  "95 % intervals. The stated places, taken together, hold the frames.</p>", _moves(places), _residuals(places)]
    if suspects:
        parts.insert(1, "<h2>Markers that are not what rig.toml says</h2><p class=note>What disagrees is left out of the poses.</p><ul>"
                     + "".join(f"<li>{html.escape(str(suspect))}</li>" for suspect in suspects) + "</ul>")
    worst = _worst_markers(m)
    if worst:
        parts += ["<h2>Markers that disagree</h2><p class=note>Share of a marker's corners set aside: a face askew, a wrong print, a covered "
                  "marker.</p>", table(("marker", "corners", "set aside"), worst)]
    if m.unsolved:
        parts += ["<h2>Frames without a pose</h2>", table(("frame", "reason"), sorted(m.unsolved.items()))]
    if collected is not None and collected.left_out:
        parts += [f"<h2>Markers read but not placed</h2><details><summary>{len(collected.left_out)} of them</summary>",
                  table(("frame", "camera", "marker", "reason"), [row[:4] for row in collected.left_out]), "</details>"]
    page(path, f"Measurement of {recording.folder.resolve().name}", parts)


def _residual_maps(m: Measurement) -> Figure:
    cameras = m.design.cameras
    figure = Figure(figsize=(11, 3.4 * -(-len(cameras) // 3)), layout="constrained")
    for i, camera in enumerate(cameras):
        axes = figure.add_subplot(-(-len(cameras) // 3), min(3, len(cameras)), i + 1)
        rows = (m.observations.camera == i) & m.inliers
        axes.set(title=f"{camera.name}: {rows.sum()} corners", xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
        if not rows.any():
            continue
        uv, r = m.observations.uv[rows], m.residuals[rows]
        cell = camera.width / 16
        key = (uv // cell).astype(int) @ [1, 1000]
        keys, index, count = np.unique(key, return_inverse=True, return_counts=True)
        mean = np.stack([np.bincount(index, weights=r[:, c]) / count for c in range(2)], axis=1)
        centre = np.stack([keys % 1000, keys // 1000], axis=1) * cell + cell / 2
        enough = count >= 5
        rms = np.sqrt(np.bincount(index, weights=(r**2).sum(axis=1)) / count / 2)
        dots = axes.scatter(centre[enough, 0], centre[enough, 1], c=rms[enough], s=40, cmap="viridis", marker="s", alpha=0.5)
        scale = max(np.abs(mean[enough]).max(initial=0), 1e-6) / (0.8 * cell)
        axes.quiver(*centre[enough].T, *mean[enough].T, angles="xy", scale_units="xy", scale=scale, color="crimson", width=0.004)
        figure.colorbar(dots, ax=axes, label="RMS, px", shrink=0.8)
        axes.set_xlabel(f"longest arrow {scale * 0.8 * cell:.3f} px", fontsize=8)
    return figure


def coverage(vectors: np.ndarray) -> Figure:
    """Figure of where poses lie: vectors (n, 6) position (m) and rotation vector (rad)."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for a, (i, j) in zip(axes[:2], ((0, 1), (0, 2))):
        a.plot(vectors[:, i] * 1e3, vectors[:, j] * 1e3, ".", ms=4)
        a.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm")
    for k, name in enumerate(("rx", "ry", "rz")):
        axes[2].plot(np.degrees(vectors[:, 3 + k]), ".", ms=3, label=name)
    axes[2].set(xlabel="solved frame", ylabel="rotation vector, degrees")
    axes[2].legend(fontsize=8)
    return figure


def _uncertainty(m: Measurement, position: np.ndarray, rotation: np.ndarray) -> Figure:
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(m.frames, position * 1e6, ".", ms=4)
    left.set(xlabel="frame", ylabel="position, um", ylim=(0, 1.1e6 * position.max()))
    right.plot(m.frames, rotation * 1e6, ".", ms=4, color="tab:orange")
    right.set(xlabel="frame", ylabel="rotation, urad", ylim=(0, 1.1e6 * rotation.max()))
    return figure


def _cameras(recording: Recording, m: Measurement) -> str:
    sigma = dict(zip(m.adjustment.shared_names, np.sqrt(np.diag(m.adjustment.shared_covariance))))
    rows = []
    for stated, found in zip(recording.design.cameras, m.design.cameras):
        moved = vector(stated.pose.inv() * found.pose)
        rows.append((found.name, f"{np.linalg.norm(moved[:3]) * 1e3:.3f}", f"{np.linalg.norm(moved[3:]) * 1e3:.3f}",
                     *(f"{value:.3f} ± {2 * sigma.get((found.name, term), 0):.3f}" for term, value in
                       (("fx", found.matrix[0, 0]), ("fy", found.matrix[1, 1]), ("cx", found.matrix[0, 2]), ("cy", found.matrix[1, 2])))))
    return table(("camera", "moved, mm", "turned, mrad", "fx, px (k = 2)", "fy", "cx", "cy"), rows)


def _moves(places: Places) -> str:
    rows = [(move.name, "yes" if move.moved else "no", *(f"{by * 1e3:+.3f} ± {half * 1e3:.3f}" for by, half in zip(move.by, move.ci95)))
            for move in places.moves]
    return table(("marker", "moved", "x, mm", "y, mm", "z, mm", "rx, mrad", "ry, mrad", "rz, mrad"), rows)


def _residuals(places: Places) -> Figure:
    figure = Figure(figsize=(11, 2.8), layout="constrained")
    axes = figure.subplots()
    axes.semilogy(places.frames, places.before, ".", ms=4, label="places as stated")
    axes.semilogy(places.frames, places.after, ".", ms=4, label="as adjusted")
    axes.set(xlabel="frame", ylabel="platform's corners, RMS px")
    axes.legend(fontsize=8)
    return figure


def _worst_markers(m: Measurement) -> list[tuple[int, int, str]]:
    o, known = m.observations, np.isfinite(m.residuals[:, 0])
    rows = []
    for marker in np.unique(o.marker[known]):
        own = known & (o.marker == marker)
        share = 1 - m.inliers[own].mean()
        if share > 0.05:
            rows.append((share, int(marker), int(own.sum())))
    ids = m.ids()
    return [(ids[marker], count, f"{share:.0%}") for share, marker, count in sorted(rows, reverse=True)[:12]]


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
    page(path, f"Calibration from {recording.folder.resolve().name}", parts)


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
    return table(("what", "value"), flat({name: part for name, part in calibration.provenance.items() if name != "data"}))


def flat(tree: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Rows (name, value) of a nested dict, for a table."""
    rows: list[tuple[str, Any]] = []
    for key, value in tree.items():
        name = f"{prefix}{key}"
        rows += flat(value, name + " / ") if isinstance(value, dict) else [(name, " ".join(map(str, value)) if isinstance(value, list) else value)]
    return rows
