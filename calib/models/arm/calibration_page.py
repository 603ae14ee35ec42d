"""HTML page of an arm's calibration.

Before and after on held-out poses, joint profiles, coverage, parameters, rank.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.held_out_errors import Figures, errors_before_and_after_correction
from calib.models.arm import error_model_and_observations
from calib.models.arm.certification import CertifiedArm
from calib.models.arm.tilt_observations import tilt_report
from calib.report.platform_and_lens_calibration_pages import evidence_html, view_3d_html, write_page_of_calibration
from calib.report.pose_and_effect_figures import FITTED, correction_error_figures, pose_coverage_figures
from calib.samples.pose_samples import Samples
from calib.workspace.workspace_page import workspace_section_html
from rig.effects.framework.effect_parameters_and_covariates import PLOT_UNITS
from rig.model import mechanisms
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import (
    captioned_html,
    folding_section_html,
    heading_html,
    paragraph_html,
    section_html,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.pages.plots import Series, panel_row_html, plot_panel_svg


def write_arm_calibration_page(
    path: Path | str,
    recording: Recording,
    calibration: Calibration,
    samples: Samples,
    certified: CertifiedArm,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of an arm's calibration, as certified on held-out samples.

    links : to other pages
    """
    went = np.concatenate([samples.T_base_platform.translation, samples.T_base_platform.rotation.as_rotvec()], axis=1)
    parts = [
        heading_html("Errors before and after, by pose"),
        correction_error_figures(
            *errors_before_and_after_correction(calibration.correction, samples), samples.frame, FITTED
        ),
        *section_html("At poses that were not fitted", _held(certified) + evidence_html(calibration)),
        *view_3d_html(recording, calibration, samples),
        heading_html("Correction of each joint"),
        captioned_html(
            _profiles(calibration, samples),
            "Correction of each joint along the visited configurations, excluding its offset.",
        ),
        heading_html("Positions of the target"),
        pose_coverage_figures(went),
        *workspace_section_html(calibration.workspace, "rad"),
        heading_html("Parameters"),
        *(paragraph_html(f"{line}.") for line in certified.found.rank.report()),
        *(paragraph_html(f"{line}.") for line in tilt_report(samples.tilts, certified.found.tilts)),
        folding_section_html("Every parameter's change", _arm_parameters(calibration)),
    ]
    write_page_of_calibration(path, recording, calibration, parts, links)


def _held(done: CertifiedArm) -> list[str]:
    held = done.held_out
    if held is None or done.geometry is None:
        return []
    floor = " and ".join(f"{size * 1e3:.4f} {unit}" for size, unit in zip(held.floor, ("mm", "mrad")) if size < 1)
    floor += "".join(
        f"; {what} were not measured" for size, what in zip(held.floor, ("positions", "rotations")) if not size < 1
    )
    k, unit = (0, "mm") if held.floor[0] < 1 else (1, "mrad")
    each = [("nominal model", held.before), ("geometry alone", done.geometry.after), ("corrected", held.after)]
    each += [("corrected, random rows", done.scattered.after)] if done.scattered is not None else []
    rows = [(name, *_figures(f)) for name, f in each]
    return [
        paragraph_html(
            f"Held-out poses (whole stretches of configurations in turn, N = {held.after.n}, "
            f"{held.configurations} distinct "
            f"configurations): the mean error falls from {held.before.mean[k] * 1e3:.3f} {unit} to "
            f"{held.after.mean[k] * 1e3:.4f} {unit}. "
            f"The uncertainty of the measured poses is {floor}."
            + (
                " Randomly chosen rows are optimistic: their neighbours in time were fitted."
                if done.scattered is not None
                else ""
            )
        ),
        table_html(("held-out error", "mean, mm", "RMS", "95 %", "max", "mean, mrad", "RMS", "95 %", "max"), rows),
    ]


def _figures(f: Figures) -> list[str]:
    return [
        f"{value * 1e3:.4f}" if value == value else "-" for value in (f.mean[0], *f.position, f.mean[1], *f.rotation)
    ]


def _profiles(calibration: Calibration, samples: Samples) -> str:
    q, nominal = samples.commanded, calibration.correction.nominal
    rho, units = calibration.correction.rho(q), mechanisms.axis_units(nominal)
    places = mechanisms.axis_place_texts(nominal)
    return panel_row_html(
        *(
            plot_panel_svg(
                places[i],
                (f"commanded, {PLOT_UNITS[unit][1]}", f"correction, m{unit}"),
                [Series(q[:, i] * PLOT_UNITS[unit][0], rho[:, i] * 1e3)],
            )
            for i, unit in enumerate(units)
        )
    )


def _change_cell(change: float, sigma: float) -> str:
    return f"{change * 1e3:+.4f} ± {2 * sigma * 1e3:.4f}" if sigma else "held"


def _arm_parameters(calibration: Calibration) -> str:
    fitted, nominal = calibration.correction.fitted, calibration.correction.nominal
    sigma = np.sqrt(np.diag(calibration.covariance))[6 : 6 + 5 * len(nominal.joints)].reshape(-1, 5)
    change = fitted.rows - nominal.rows
    rows = [(f"row {i + 1}", *(_change_cell(c, s) for c, s in zip(change[i], sigma[i]))) for i in range(len(change))]
    units = [
        f"{name}, {'mm' if unit == 'm' else 'mrad'}"
        for name, unit in zip(
            error_model_and_observations.ROW, error_model_and_observations.parameter_units(fitted)[6:11]
        )
    ]
    return table_html(("change from nominal (k = 2)", *units), rows)
