"""The page of a lens calibration: models held out, residual map, uncertainty of projection over the frame."""

import html
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calib.html_page import page, table
from vision.lenses.photographs import Calibrated


def lens_page(path: Path | str, found: Calibrated) -> None:
    """Write the page of a Calibrated."""
    fit, held = found.fit, found.models[found.fit.terms].held
    rows = [(f"{terms} terms" if terms else "no distortion", *((f"{model.rms:.4f}", f"{model.held.rms:.4f}") if model.held else (model.reason, "")),
             "taken" if terms == fit.terms else "") for terms, model in found.models.items()]
    names = [*("fx", "fy", "cx", "cy"), *[name for _, name in fit.adjustment.shared_names[4:]]]
    values = [fit.camera.matrix[0, 0], fit.camera.matrix[1, 1], *fit.camera.matrix[:2, 2], *fit.camera.distortion]
    sigma = np.sqrt(np.diag(fit.adjustment.shared_covariance) * fit.adjustment.cost / fit.adjustment.dof)
    terms = [(name, f"{value:.6g}", f"{2 * s:.2g}") for name, value, s in zip(names, values, sigma)][: 4 + max(fit.terms, 0)]
    parts: list[str | Figure]
    parts = [f"<p>{len(found.used)} photographs, {fit.inliers.sum()} corners; the fit leaves {fit.rms:.4f} px RMS per axis, on photographs held "
             f"out {f'{held.rms:.4f} px' if held else 'nothing is known'}. A direction is projected to {found.middle:.3f} px in the middle of the "
             f"frame and {found.worst:.3f} px at worst (standard uncertainty).</p>",
             "<h2>Lens models</h2><p class=note>Every photograph in turn is predicted by a lens fitted to the others; of models within one standard "
             "error of the best the simplest is taken.</p>", table(("model", "fitted, px RMS", "held out, px RMS", ""), rows), _held(found),
             "<h2>What the lens leaves over</h2>", _residuals(found),
             "<h2>Uncertainty of projection</h2><p class=note>Standard uncertainty of where a direction is seen, px, less what a small turn of the "
             "camera would undo. Dots: corners. Few of them, or none, near an edge make it grow there.</p>", _uncertainty(found),
             "<h2>Parameters</h2>", table(("term", "value", "± (k = 2)"), terms)]
    if found.left_out:
        parts += ["<h2>Photographs left out</h2>", table(("photograph", "reason"), [(p.name, reason) for p, reason in found.left_out])]
    page(path, f"Lens of {html.escape(fit.camera.name)}", parts)


def _held(found: Calibrated) -> Figure:
    figure = Figure(figsize=(11, 2.8), layout="constrained")
    axes = figure.subplots()
    for terms, model in found.models.items():
        if model.held:
            axes.plot(model.held.by_image, "o-", ms=4, lw=0.8, label=f"{terms} terms" if terms else "no distortion")
    axes.set_xticks(range(len(found.used)), [path.name for path in found.used], fontsize=7, rotation=30)
    axes.set(ylabel="held out, px RMS", yscale="log")
    axes.legend(fontsize=7, ncols=6)
    return figure


def _residuals(found: Calibrated) -> Figure:
    fit, uv = found.fit, found.observations.uv
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots()
    r, good = fit.residuals, fit.inliers
    scale = np.quantile(np.abs(r[good]), 0.98) / (0.03 * fit.camera.width)
    axes.quiver(*uv[good].T, *r[good].T, found.observations.frame[good], angles="xy", scale_units="xy", scale=max(scale, 1e-9), cmap="tab20",
                width=0.0015)
    axes.plot(*uv[~good].T, "rx", ms=5)
    axes.set(xlim=(0, fit.camera.width), ylim=(fit.camera.height, 0), aspect="equal",
             title=f"residuals, an arrow of {0.03 * fit.camera.width:.0f} px is {scale * 0.03 * fit.camera.width:.3f} px; a colour per photograph")
    return figure


def _uncertainty(found: Calibrated) -> Figure:
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots()
    drawn = axes.pcolormesh(found.uv[..., 0], found.uv[..., 1], found.sigma, cmap="viridis", shading="nearest")
    axes.plot(*found.observations.uv.T, "w.", ms=2)
    axes.set(xlim=(0, found.fit.camera.width), ylim=(found.fit.camera.height, 0), aspect="equal")
    figure.colorbar(drawn, ax=axes, label="px", shrink=0.8)
    return figure
