"""HTML page of a lens calibration: held-out models, residual map and projection uncertainty."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rig.report.pages.html_elements import heading, note, paragraph, table
from rig.report.pages.image_plane_figures import Arrows, Cells, image_plane_figure
from rig.report.pages.page_and_svg_templates import Link, Page, write_page
from rig.report.pages.plots import Series, panel_row, plot_panel
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence
from vision.lenses.board_photographs import Calibrated

DRAWN = 0.03  # of the image's width, by which the common residuals are drawn
FEW = 10  # photographs, below which a lens is to be looked at
UNSURE = 0.5  # px at worst, from which it is so too


def write_lens_page(path: Path | str, lens_calibration: Calibrated, links: Sequence[Link] = ()) -> None:
    """Write the HTML page of a lens calibration."""
    fit, held = lens_calibration.fit, lens_calibration.models[lens_calibration.fit.terms].held
    names = [*("fx", "fy", "cx", "cy"), *[name for _, name in fit.adjustment.shared_names[4:]]]
    values = [fit.camera.matrix[0, 0], fit.camera.matrix[1, 1], *fit.camera.matrix[:2, 2], *fit.camera.distortion]
    sigma = np.sqrt(np.diag(fit.adjustment.shared_covariance) * fit.adjustment.cost / fit.adjustment.dof)
    terms = [(name, f"{value:.6g}", f"{2 * s:.2g}") for name, value, s in zip(names, values, sigma)][
        : 4 + max(fit.terms, 0)
    ]
    parts = [
        paragraph(
            f"{len(lens_calibration.used)} photographs, {fit.inliers.sum()} corners; the fit leaves {fit.rms:.4f} px "
            "RMS per axis, on photographs "
            f"held out {f'{held.rms:.4f} px' if held else 'nothing is known'}."
        ),
        heading("Lens models"),
        note(
            "Every photograph in turn is predicted by a lens fitted to the others; of models within one "
            "standard error of the best the "
            "simplest is taken."
        ),
        table(("model", "fitted, px RMS", "held out, px RMS", ""), _models(lens_calibration)),
        heading("What the lens leaves over, and how well it is known"),
        note(
            "Uncertainty: the standard one of where a direction is seen, px, less what a small turn of the "
            "camera would undo. Dots are "
            "corners; few of them, or none, near an edge make it grow there."
        ),
        panel_row(_residuals(lens_calibration), _uncertainty(lens_calibration), _held(lens_calibration)),
        heading("Parameters"),
        table(("term", "value", "± (k = 2)"), terms),
    ]
    if lens_calibration.left_out:
        parts += [
            heading("Photographs left out"),
            table(("photograph", "reason"), [(p.name, reason) for p, reason in lens_calibration.left_out]),
        ]
    write_page(
        path,
        Page(
            "lens",
            f"Lens of {fit.camera.name}",
            lens_verdict(lens_calibration),
            parts,
            _recommended_actions(lens_calibration),
            links,
        ),
    )


def lens_verdict(lens_calibration: Calibrated) -> Verdict:
    """Verdict on a lens calibration."""
    why = (
        f"a direction is projected to {lens_calibration.middle:.3f} px in the middle of the frame and "
        f"{lens_calibration.worst:.3f} px "
        "at worst (standard uncertainty)"
    )
    missing = (
        [Missing("no photograph could be held out")]
        if lens_calibration.models[lens_calibration.fit.terms].held is None
        else []
    )
    missing += (
        [Missing(f"it rests on {len(lens_calibration.used)} photographs alone")]
        if len(lens_calibration.used) < FEW
        else []
    )
    missing += [Missing(f"that is more than {UNSURE:g} px")] if lens_calibration.worst > UNSURE else []
    return judge_evidence(Evidence(why, missing=tuple(missing)))


def _recommended_actions(found: Calibrated) -> list[str]:
    """What an owner does next with a lens."""
    more = (
        "Take more photographs with the board near the edges that are bluest in the map of uncertainty, tilted "
        "this way and that"
    )
    steps = [more] if len(found.used) < FEW or found.worst > UNSURE else []
    return [*steps, "Put `camera.toml` into rig.toml in place of the camera's block, and measure with `--hold lenses`"]


def _models(found: Calibrated) -> list[tuple[str, ...]]:
    return [
        (
            f"{terms} terms" if terms else "no distortion",
            *((f"{model.rms:.4f}", f"{model.held.rms:.4f}") if model.held else (model.reason, "")),
            "taken" if terms == found.fit.terms else "",
        )
        for terms, model in found.models.items()
    ]


def _held(found: Calibrated) -> str:
    known = [(terms, model.held) for terms, model in found.models.items() if model.held]
    return plot_panel(
        "photograph by photograph",
        ("photograph", "held out, px RMS"),
        [
            Series(
                np.arange(len(held.by_image)),
                np.asarray(held.by_image),
                f"{terms} terms" if terms else "no distortion",
                colour=k,
            )
            for k, (terms, held) in enumerate(known)
        ],
        log=True,
    )


def _residuals(found: Calibrated) -> str:
    camera, uv, r, good = found.fit.camera, found.observations.uv, found.fit.residuals, found.fit.inliers
    drawn = DRAWN * camera.width
    common = max(float(np.quantile(np.abs(r[good]), 0.98)), 1e-9)
    return image_plane_figure(
        f"residuals of {good.sum()} corners",
        f"an arrow of {drawn:.0f} px is {common:.3f} px",
        (camera.width, camera.height),
        (Arrows(uv[good], r[good], drawn / common, "px", 0), Arrows(uv[~good], r[~good], 1.0, "px, set aside", 3)),
    )


def _uncertainty(found: Calibrated) -> str:
    camera, centre = found.fit.camera, found.uv.reshape(-1, 2)
    cells = Cells(centre, found.sigma.ravel(), float(abs(found.uv[0, 1, 0] - found.uv[0, 0, 0])), "px")
    return image_plane_figure(
        f"uncertainty, {found.middle:.3f} px in the middle",
        f"where it is bluest: {found.worst:.3f} px",
        (camera.width, camera.height),
        (cells,),
        found.observations.uv,
    )
