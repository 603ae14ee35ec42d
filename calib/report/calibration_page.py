"""HTML page of a platform's calibration: verdict, errors, corrections and parameters in mm and mrad."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.certification.calibration import Calibration, claim_lines
from calib.certification.calibration_evidence import calibration_verdict
from calib.certification.held_out_errors import Figures, HeldOut, errors_before_and_after_correction
from calib.correction.correction import Correction
from calib.correction.interpolation.gaussian_process import Radial
from calib.models.platform.identification import Identified
from calib.models.platform.parameter_accuracy import parameter_combinations
from calib.report.pose_figures import correction_error_figures, pose_coverage_figures, rig_scene
from calib.samples.pose_samples import Samples
from calib.workspace.workspace_page import workspace_section_html
from rig.formats.json_tree import Json
from rig.model import mechanisms
from rig.model.mechanism_kinds import Struts
from rig.model.pose import pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_elements import folding_section, heading, list_html, note, paragraph, table
from rig.report.pages.page_and_svg_templates import Link, Page, write_page
from rig.report.pages.plots import Series, panel_row, plot_panel
from rig.report.pages.view_3d import view_3d_html as view
from rig.report.pages.view_3d import view_scripts


def write_calibration_page(
    path: Path | str,
    recording: Recording,
    calibration: Calibration,
    samples: Samples,
    found: Identified,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of a platform's calibration: held-out errors, corrections, coverage, parameters."""
    correction = calibration.correction
    parts = [
        *evidence_html(calibration),
        *_held(calibration.held_out),
        heading("Before and after, pose by pose"),
        note("All poses; the fit has seen these."),
        correction_error_figures(*errors_before_and_after_correction(correction, samples), samples.frame),
        *view_3d_html(recording, calibration, samples),
        heading("What each strut is corrected by"),
        note("Dots: x - IK(GDK(x)) at the visited configurations. Squares: the correction at the same configurations."),
        _corrections(correction, samples),
        heading("What the correction leaves"),
        _left(samples, found),
        heading("Where the platform went"),
        pose_coverage_figures(pose_to_vector(samples.T_base_platform)),
        *workspace_section_html(calibration.workspace, "m"),
        heading("Parameters"),
        _combinations(calibration, found),
        folding_section("Every parameter's change", _parameters(calibration)),
        heading("Where this came from"),
        folding_section("Recording, versions, arguments", provenance_html(calibration)),
    ]
    judged = calibration_verdict(calibration)
    write_page(
        path,
        Page("calibrate", f"Calibration from {recording.name}", judged, parts, judged.next, links, view_scripts(parts)),
    )


def view_3d_html(recording: Recording, calibration: Calibration, samples: Samples) -> list[str]:
    """HTML of the 3-D view of the rig with errors before and after; empty where positions were not measured."""
    if not samples.measured.startswith("pos"):
        return []
    before, after = errors_before_and_after_correction(calibration.correction, samples)
    shown = rig_scene(
        recording.design,
        samples.frame,
        samples.T_base_platform,
        samples.commanded,
        {"owner's model": -before, "corrected": -after},
    )
    return [heading("In three dimensions"), *view(shown)]


def evidence_html(calibration: Calibration) -> list[str]:
    """HTML of the evidence for a calibration and its claim; empty without a claim."""
    claim = calibration.claim
    return [] if claim is None else [list_html([*calibration_verdict(calibration).rests_on, *claim_lines(claim)[1:]])]


def _held(held: HeldOut | None) -> list[str]:
    if held is None:
        return []
    rows = [("owner's model", *_figures(held.before)), ("corrected", *_figures(held.after))]
    return [
        paragraph(
            f"Held-out poses (whole stretches of configurations in turn, N = {held.after.n}, "
            f"{held.configurations} distinct "
            f"configurations): the error falls from {held.before.position[0] * 1e3:.3f} mm to "
            f"{held.after.position[0] * 1e3:.4f} mm RMS. "
            f"The measured poses themselves are uncertain by {held.floor[0] * 1e3:.4f} mm and "
            f"{held.floor[1] * 1e3:.4f} mrad: what is left "
            f"is {held.after.position[0] / held.floor[0]:.2f} times that."
        ),
        table(("held-out pose error", "RMS, mm", "95 %, mm", "max, mm", "RMS, mrad", "95 %, mrad", "max, mrad"), rows),
    ]


def _combinations(calibration: Calibration, found: Identified) -> str:
    """Every combination of the parameters with how well the poses tell it, folded."""
    parts, seen = parameter_combinations(found.root, calibration.correction.fitted)
    rows = [(part.name, f"{part.sigma * 1e6:.2f}" if part.sigma < 1e-2 else "not told") for part in parts]
    return folding_section(
        f"The {len(parts)} combinations that the poses tell, the worst first (condition number {seen.condition:.0f})",
        table(("combination", "standard error by the poses alone, um"), rows),
    )


def _figures(f: Figures) -> list[str]:
    return [f"{value * 1e3:.4f}" for value in (*f.position, *f.rotation)]


def _corrections(correction: Correction[Struts, Radial], samples: Samples) -> str:
    seen = samples.effective - mechanisms.kinematics_of(correction.nominal).inverse(
        samples.T_base_platform, correction.nominal
    )
    modelled, commanded = correction.summand(samples.effective) * 1e3, samples.commanded * 1e3
    return panel_row(
        *(
            plot_panel(
                f"strut {i + 1}",
                ("commanded, mm", "correction, mm"),
                [
                    Series(commanded[:, i], modelled[:, i], "correction", "crosses", 1),
                    Series(commanded[:, i], seen[:, i] * 1e3, "measured"),
                ],
            )
            for i in range(seen.shape[1])
        )
    )


def _left(samples: Samples, found: Identified) -> str:
    sigma = float(np.sqrt(np.einsum("nii->ni", found.residual_covariance).mean())) * 1e6
    struts = found.residuals * 1e6
    top = 1.05 * max(float(np.nanmax(np.abs(struts))), 2 * sigma)
    return paragraph(f"Two standard deviations of a pose are {2 * sigma:.1f} um in a strut.") + panel_row(
        *(
            plot_panel(
                f"strut {i + 1}",
                ("frame", "left, um"),
                [Series(samples.frame, struts[:, i])],
                limits=(-top, top),
                level=0.0,
            )
            for i in range(struts.shape[1])
        )
    )


def _parameters(calibration: Calibration) -> str:
    fitted, nominal = calibration.correction.fitted, calibration.correction.nominal
    sigma = np.sqrt(np.diag(calibration.covariance))
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
    return table(("change from nominal, mm (k = 2)", "x or zero", "y", "z"), rows)


def provenance_html(calibration: Calibration) -> str:
    """HTML of a calibration's provenance."""
    rows = {name: part for name, part in calibration.provenance.items() if name not in ("data", "passes")}
    before = {
        f"pass {k + 1}": {name: one[name] for name in ("recording", "created", "pass") if name in one}
        for k, one in enumerate(calibration.provenance.get("passes", ()))
    }
    return table(("what", "value"), flattened_rows(before | rows))


def flattened_rows(tree: Json, prefix: str = "") -> list[tuple[str, object]]:
    """Rows (name, value) of a nested dict, flattened for a table."""
    rows: list[tuple[str, object]] = []
    for key, value in tree.items():
        name = f"{prefix}{key}"
        rows += (
            flattened_rows(value, name + " / ")
            if isinstance(value, dict)
            else [(name, " ".join(map(str, value)) if isinstance(value, list) else value)]
        )
    return rows
