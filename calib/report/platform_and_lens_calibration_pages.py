"""HTML pages of a platform's calibration and of a lens calibration."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, claim_lines
from calib.certification.calibration_evidence_verdict_and_claim_check import calibration_verdict
from calib.certification.held_out_pose_error_statistics import Figures, HeldOut, errors_before_and_after_correction
from calib.correction.interpolation.gaussian_process_interpolation import Radial
from calib.correction.machine_correction import Correction
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    parameter_combinations_and_visibility,
)
from calib.models.platform.platform_identification import Identified
from calib.report.pose_and_effect_figures import FITTED, correction_error_figures, pose_coverage_figures, rig_scene
from calib.samples.commanded_and_measured_pose_samples import Samples
from calib.workspace.workspace_page import workspace_section_html
from rig.array_and_json_types import Floats, Json
from rig.effects.framework.parameters_covariates_and_marker_table import PLOT_UNITS
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    geometric_parameters,
    has_struts,
    parameter_names,
    parameter_units_and_scales,
)
from rig.model.pose import pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import (
    collapsible_section_html,
    figures_with_caption_html,
    heading_html,
    list_html,
    note_html,
    paragraph_html,
    section_html,
    table_html,
)
from rig.report.pages.image_plane_and_3d_views import Arrows, Cells, image_plane_figure, view_3d_scripts_if_needed
from rig.report.pages.image_plane_and_3d_views import view_3d_html as view
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, figures_side_by_side_html, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import Evidence, MissingEvidence, Verdict, judge_evidence
from vision.lenses.lens_calibration_from_photographs import Calibrated


def write_platform_calibration_page(
    path: Path | str,
    recording: Recording,
    calibration: Calibration,
    samples: Samples,
    identified: Identified,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of a platform's calibration.

    Held-out errors, corrections, coverage, parameters.
    """
    correction = calibration.correction
    parts = [
        heading_html("Errors before and after, by pose"),
        correction_error_figures(*errors_before_and_after_correction(correction, samples), samples.frame, FITTED),
        *section_html("At poses that were not fitted", _held(calibration.held_out) + evidence_html(calibration)),
        *view_3d_html(recording, calibration, samples),
        heading_html("Correction of each strut"),
        figures_with_caption_html(
            _corrections(correction, samples),
            "Dots: each commanded length less the length that the nominal model gives for the measured pose, in mm or "
            "mrad. Crosses: the correction. Good: crosses cover the dots. Bad: dots that scatter far from the crosses.",
        ),
        heading_html("Residuals of the correction"),
        _left(samples, identified),
        heading_html("Positions of the platform"),
        pose_coverage_figures(pose_to_vector(samples.T_base_platform)),
        *workspace_section_html(calibration.workspace, "m"),
        heading_html("Parameters"),
        _combinations(calibration, identified),
        collapsible_section_html("Every parameter's change", _parameters(calibration)),
    ]
    write_calibration_page_from_parts(path, recording, calibration, parts, links)


def write_calibration_page_from_parts(
    path: Path | str, recording: Recording, calibration: Calibration, parts: list[str], links: Sequence[Link]
) -> None:
    """Write a calibration's page.

    Its parts, its provenance below them, and its verdict above.
    parts : HTML of a kind of machine; links : to other pages. Raises FileError for a path that cannot be written
    """
    judged = calibration_verdict(calibration)
    whole = [
        *parts,
        heading_html("Provenance"),
        collapsible_section_html("Recording, versions, arguments", provenance_html(calibration)),
    ]
    title, scripts = f"Calibration from {recording.name}", view_3d_scripts_if_needed(whole)
    write_page(path, Page("calibrate", title, judged, whole, judged.next, links, scripts))


def view_3d_html(recording: Recording, calibration: Calibration, samples: Samples) -> list[str]:
    """HTML of the 3-D view of the rig with errors before and after.

    Empty where positions were not measured.
    """
    if not samples.measured.startswith("pos"):
        return []
    before, after = errors_before_and_after_correction(calibration.correction, samples)
    shown = rig_scene(
        recording.design,
        samples.frame,
        samples.T_base_platform,
        samples.commanded,
        {"nominal model": -before, "corrected": -after},
    )
    return [heading_html("In three dimensions"), *view(shown)]


def evidence_html(calibration: Calibration) -> list[str]:
    """HTML of the evidence for a calibration.

    It is for its claim too, and says what has no name.
    Empty without a claim.
    """
    claim, physics = calibration.claim, calibration.physics
    if claim is None:
        return []
    unknown = [] if physics is None else [u.sentence() for u in physics.unknown]
    return [list_html([*calibration_verdict(calibration).rests_on, *claim_lines(claim)[1:], *unknown])]


def _held(held: HeldOut | None) -> list[str]:
    if held is None:
        return []
    rows = [("nominal model", *_figures(held.before)), ("corrected", *_figures(held.after))]
    return [
        paragraph_html(
            f"Held-out poses (whole stretches of configurations in turn, N = {held.after.n}, "
            f"{held.configurations} distinct "
            f"configurations): the error falls from {held.before.position[0] * 1e3:.3f} mm to "
            f"{held.after.position[0] * 1e3:.4f} mm RMS. "
            f"The uncertainty of the measured poses is {held.floor[0] * 1e3:.4f} mm and "
            f"{held.floor[1] * 1e3:.4f} mrad: the residual "
            f"is {held.after.position[0] / held.floor[0]:.2f} times that."
        ),
        table_html(
            ("held-out pose error", "RMS, mm", "95 %, mm", "max, mm", "RMS, mrad", "95 %, mrad", "max, mrad"), rows
        ),
    ]


def _combinations(calibration: Calibration, found: Identified) -> str:
    """Every combination of the parameters with how well the poses tell it, folded."""
    parts, seen = parameter_combinations_and_visibility(found.root, calibration.correction.fitted)
    rows = [(part.name, f"{part.sigma * 1e6:.2f}" if part.sigma < 1e-2 else "not known") for part in parts]
    return collapsible_section_html(
        f"The {len(parts)} combinations determined by the poses, worst first (condition number {seen.condition:.0f})",
        table_html(("combination", "standard error from the poses alone, um"), rows),
    )


def _figures(f: Figures) -> list[str]:
    return [f"{value * 1e3:.4f}" for value in (*f.position, *f.rotation)]


def _corrections(correction: Correction[Parallel, Radial], samples: Samples) -> str:
    seen = samples.effective - mechanisms.kinematics_of(correction.nominal).inverse(
        samples.T_base_platform, correction.nominal
    )
    modelled, commanded = correction.summand(samples.effective) * 1e3, samples.commanded
    places, units = mechanisms.axis_place_texts(correction.nominal), mechanisms.axis_units(correction.nominal)
    return figures_side_by_side_html(
        *(
            plot_panel_svg(
                places[i],
                (f"commanded, {PLOT_UNITS[unit][1]}", f"correction, m{unit}"),
                [
                    Series(commanded[:, i] * PLOT_UNITS[unit][0], modelled[:, i], "correction", "crosses", 1),
                    Series(commanded[:, i] * PLOT_UNITS[unit][0], seen[:, i] * 1e3, "measured"),
                ],
            )
            for i, unit in enumerate(units)
        )
    )


def _left(samples: Samples, found: Identified) -> str:
    sigma = float(np.sqrt(np.einsum("nii->ni", found.residual_covariance).mean())) * 1e6
    struts = found.residuals * 1e6
    top = 1.05 * max(float(np.nanmax(np.abs(struts))), 2 * sigma)
    places, unit = mechanisms.axis_place_texts(found.mechanism), found.mechanism.axis_unit
    part = found.mechanism.axis_words[0]
    panels = (
        plot_panel_svg(
            places[i], ("frame", f"left, u{unit}"), [Series(samples.frame, struts[:, i])], limits=(-top, top), level=0.0
        )
        for i in range(struts.shape[1])
    )
    noise = f"Two standard deviations of a measured pose are {2 * sigma:.1f} u{unit} in a {part}."
    looks = f"Good: dots around 0, nearly all within {2 * sigma:.1f} u{unit}. Bad: a trend, steps, or far dots."
    return figures_with_caption_html(
        figures_side_by_side_html(*panels), f"What the correction leaves, in u{unit}. {noise} {looks}"
    )


def _parameters(calibration: Calibration) -> str:
    fitted, nominal = calibration.correction.fitted, calibration.correction.nominal
    sigma = np.sqrt(np.diag(calibration.covariance))
    if not has_struts(nominal):
        return _parameters_by_name(fitted, nominal, sigma)
    rows, start = [], 0
    for name in nominal.geometry_arrays:
        for i, own in enumerate((getattr(fitted, name) - getattr(nominal, name)).reshape(len(nominal.axes), -1)):
            u = sigma[start : start + len(own)]
            rows.append(
                (
                    f"{name.replace('_', ' ')[:-1]} {i + 1}",
                    *(f"{c * 1e3:+.4f} ± {2 * s * 1e3:.4f}" for c, s in zip(own, u)),
                    *[""] * (3 - len(own)),
                )
            )
            start += len(own)
    return table_html(("change from nominal, mm (k = 2)", "x or zero", "y", "z"), rows)


def _parameters_by_name(fitted: Parallel, nominal: Parallel, sigma: Floats) -> str:
    """Table of the parameters of a kinematics file. sigma : (p,) of the scaled ones, see `geometric_parameters`"""
    steps = geometric_parameters(fitted) - geometric_parameters(nominal)
    rows = [
        (name, f"{step * scale * 1e3:+.4f} ± {2 * s * scale * 1e3:.4f}", f"m{unit}")
        for name, unit, scale, step, s in zip(
            parameter_names(nominal), *parameter_units_and_scales(nominal), steps, sigma
        )
    ]
    return table_html(("parameter", "change from nominal (k = 2)", "unit"), rows)


def provenance_html(calibration: Calibration) -> str:
    """HTML of a calibration's provenance."""
    rows = {name: part for name, part in calibration.provenance.items() if name not in ("data", "passes")}
    before = {
        f"pass {k + 1}": {name: one[name] for name in ("recording", "created", "pass") if name in one}
        for k, one in enumerate(calibration.provenance.get("passes", ()))
    }
    return table_html(("what", "value"), rows_of_nested_dict(before | rows))


def rows_of_nested_dict(tree: Json, prefix: str = "") -> list[tuple[str, object]]:
    """Rows (name, value) of a nested dict, flattened for a table."""
    rows: list[tuple[str, object]] = []
    for key, value in tree.items():
        name = f"{prefix}{key}"
        rows += (
            rows_of_nested_dict(value, name + " / ")
            if isinstance(value, dict)
            else [(name, " ".join(map(str, value)) if isinstance(value, list) else value)]
        )
    return rows


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
        heading_html("Residuals and uncertainty of the lens"),
        figures_with_caption_html(
            figures_side_by_side_html(
                _residuals(lens_calibration), _uncertainty(lens_calibration), _held_out_comparison(lens_calibration)
            ),
            "Residuals (px): red ones were rejected. Uncertainty: the standard uncertainty of a projected direction, "
            "px, less what a small rotation of the camera would compensate. Dots are corners; few or none near an edge "
            "increase it there. Photographs: held-out residuals of each model, px RMS. Good: arrows in all directions, "
            "corners up to every edge. Bad: arrows that turn together, empty corners, one photograph far above.",
        ),
        paragraph_html(
            f"{len(lens_calibration.used)} photographs, {fit.inliers.sum()} corners; the fit leaves {fit.rms:.4f} px "
            "RMS per axis, on photographs "
            f"held out {f'{held.rms:.4f} px' if held else 'nothing is known'}."
        ),
        heading_html("Lens models"),
        note_html(
            "Each photograph is predicted by a lens fitted to the others; of models within one "
            "standard error of the best the "
            "simplest is used."
        ),
        table_html(("model", "fitted, px RMS", "held out, px RMS", ""), _models(lens_calibration)),
        heading_html("Parameters"),
        table_html(("term", "value", "± (k = 2)"), terms),
    ]
    if lens_calibration.left_out:
        parts += [
            heading_html("Photographs excluded"),
            table_html(("photograph", "reason"), [(p.name, reason) for p, reason in lens_calibration.left_out]),
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
        [MissingEvidence("no photograph could be held out")]
        if lens_calibration.models[lens_calibration.fit.terms].held is None
        else []
    )
    missing += (
        [MissingEvidence(f"it is based on {len(lens_calibration.used)} photographs only")]
        if len(lens_calibration.used) < FEW
        else []
    )
    missing += [MissingEvidence(f"that is more than {UNSURE:g} px")] if lens_calibration.worst > UNSURE else []
    return judge_evidence(Evidence(why, missing=tuple(missing)))


def _recommended_actions(found: Calibrated) -> list[str]:
    """What an owner does next with a lens."""
    more = (
        "Take more photographs with the board near the edges that are bluest in the map of uncertainty, tilted "
        "in different directions"
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


def _held_out_comparison(found: Calibrated) -> str:
    known = [(terms, model.held) for terms, model in found.models.items() if model.held]
    return plot_panel_svg(
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
        (Arrows(uv[good], r[good], drawn / common, "px", 0), Arrows(uv[~good], r[~good], 1.0, "px, rejected", 3)),
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
