"""The page of a measurement: what the cameras leave over, where the platform went, how well each pose is known, in mm and mrad."""

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calib.html_page import coverage, page, table
from rig.pose import vector
from rig.recording import Recording
from vision.bundle.places import Places
from vision.measure import Measurement
from vision.reading.collect import Collected
from vision.reading.identity import Suspect


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
    page(path, f"Measurement of {recording.name}", parts)


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
