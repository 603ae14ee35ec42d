"""The page of a chain's calibration: what it is worth, before and after, stage by stage, and what cannot be told
apart.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.certification.calibration import Calibration
from calib.certification.calibration_evidence import calibration_verdict
from calib.certification.held_out_errors import errors_before_and_after_correction
from calib.models.chain import error_model
from calib.models.chain.certification import Certified
from calib.report.calibration_page import evidence_html, provenance_html, view_3d_html
from calib.report.pose_figures import correction_error_figures, pose_coverage_figures
from calib.samples.pose_samples import Samples
from rig.model.pose import pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_elements import folding_section, heading, note, paragraph, table
from rig.report.pages.page_and_svg_templates import Link, Page, write_page
from rig.report.pages.view_3d import view_scripts


def write_chain_calibration_page(
    path: Path | str,
    recording: Recording,
    calibration: Calibration,
    samples: Samples,
    certified: Certified,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of a chain's calibration. certified : Certified.
    recording : Recording; calibration : Calibration; samples : Samples; certified : Certified.
    """
    parts = [
        *evidence_html(calibration),
        heading("Before and after, pose by pose"),
        note("All poses; the fit has seen these."),
        correction_error_figures(*errors_before_and_after_correction(calibration.correction, samples), samples.frame),
        *view_3d_html(recording, calibration, samples),
        heading("Stage by stage"),
        *(paragraph(line) for line in certified.found.report()),
        _chain_parameters(certified),
        heading("Where the last platform went"),
        pose_coverage_figures(pose_to_vector(samples.T_base_platform)),
        heading("Where this came from"),
        folding_section("Recording, versions, arguments", provenance_html(calibration)),
    ]
    judged = calibration_verdict(calibration)
    write_page(
        path,
        Page("calibrate", f"Calibration from {recording.name}", judged, parts, judged.next, links, view_scripts(parts)),
    )


def _chain_parameters(done: Certified) -> str:
    found, nominal = done.found, done.correction.nominal
    sigma = np.sqrt(np.diag(found.covariance))
    rows = [
        (name, f"{1e3 * step:+.4f}", f"{2e3 * s:.4f}", "mm" if unit == "m" else "mrad")
        for name, unit, step, s in zip(
            error_model.parameter_names(nominal), error_model.parameter_units(nominal), found.step, sigma
        )
        if s > 0
    ]
    return folding_section("Every parameter", table(("change from nominal", "", "± (k = 2)", ""), rows))
