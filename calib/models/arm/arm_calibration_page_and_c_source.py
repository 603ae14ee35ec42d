"""HTML page of an arm's calibration, and its correction as C source.

The page shows before and after on held-out poses, joint profiles, coverage, parameters and rank. The source is one C99
file: joint commands in, corrected joint commands out.

An arm's controller has kinematics of its own, the nominal one. What it commands means a pose, that of the nominal
figures; the file finds, near these joint values, those that `rig correct` commands for this pose.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.held_out_pose_error_statistics import Figures, errors_before_and_after_correction
from calib.correction.correction_fields_as_c_functions import CTables
from calib.correction.hexapod_correction_c_source_and_shared_c_file_parts import (
    FIELDS,
    CCall,
    CSource,
    append_add_remainder_if_any,
    c_file_head_interface_and_constants,
    c_source_part,
    controller_terms_of_compensable_effects,
    effect_compensation_c_functions,
    joined_c_parts,
)
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import CertifiedArm
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_identification_and_joint_profiles import Profile
from calib.models.arm.tilt_observations import tilt_report
from calib.report.platform_and_lens_calibration_pages import (
    evidence_html,
    view_3d_html,
    write_calibration_page_from_parts,
)
from calib.report.pose_and_effect_figures import FITTED, correction_error_figures, pose_coverage_figures
from calib.samples.commanded_and_measured_pose_samples import Samples
from calib.workspace.workspace_page import workspace_section_html
from rig.array_and_json_types import Floats
from rig.effects.framework.parameters_covariates_and_marker_table import PLOT_UNITS
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_no_couplings
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.closed_form_and_numerical_arm_inverse import hand_motion_direction_counts
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import (
    collapsible_section_html,
    figures_with_caption_html,
    heading_html,
    paragraph_html,
    section_html,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.pages.svg_plots import Series, figures_side_by_side_html, plot_panel_svg


def write_arm_calibration_page(
    path: Path | str,
    recording: Recording,
    calibration: Calibration,
    samples: Samples,
    certified: CertifiedArm,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of an arm's calibration.

    It is as certified on held-out samples.
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
        figures_with_caption_html(
            _profiles(calibration, samples),
            "Correction of each joint along the visited configurations (mrad or mm), excluding its offset. Good: a "
            "narrow band, or a smooth wave. Bad: dots without a pattern that are larger than the noise.",
        ),
        heading_html("Positions of the target"),
        pose_coverage_figures(went),
        *workspace_section_html(calibration.workspace, "rad"),
        heading_html("Parameters"),
        *(paragraph_html(f"{line}.") for line in certified.found.rank.report()),
        *(paragraph_html(f"{line}.") for line in tilt_report(samples.tilts, certified.found.tilts)),
        collapsible_section_html("Every parameter's change", _arm_parameters(calibration)),
    ]
    write_calibration_page_from_parts(path, recording, calibration, parts, links)


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
    return figures_side_by_side_html(
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
            arm_error_model_and_instrument_observations.ROW,
            arm_error_model_and_instrument_observations.parameter_units(fitted)[6:11],
        )
    ]
    return table_html(("change from nominal (k = 2)", *units), rows)


CALL = CCall(
    "Corrected joint commands of an arm, as `rig correct` computes them.",
    "int rig_correct(const double joints[{0}], const double *channels, struct rig_state *state, double commands[{0}]);",
    (
        "  joints: that the nominal kinematics gives for the wanted pose, rad, of slides m; commands: as them",
        "  The pose is that of the nominal figures, base and tool as the calibration has them. Corrected commands are",
        "  those next to the joints given, on the same side of elbow and wrist; no joint is moved by a whole turn.",
    ),
    "joint",
    "the joint values",
    "commands",
)


def arm_correction_c_source(correction: ArmCorrection, physics: Physics | None, origin: str) -> CSource:
    """C source of an arm's correction (CSource).

    Of an ArmCorrection and the Physics besides, or None.
    origin : of which file and by which version it is made, for its head
    Raises RigError for a way to extend corrections and for an effect that no C file states
    """
    if correction.posed:
        raise RigError(
            "maps in pose space are not in an arm's C file: use `rig correct` or `rig correct serve`, or make the "
            "pass over configurations"
        )
    require_no_couplings(correction.nominal, "the correction is written as C")
    nominal, fitted = correction.nominal, correction.fitted
    axes = len(nominal.joints)
    call = replace(CALL, prototype=CALL.prototype.format(axes))
    effects = controller_terms_of_compensable_effects(correction, physics)
    geometry, tables = CTables(axes), CTables(axes)
    geometry.array("SLIDES", fitted.slides.astype(float), "int")
    geometry.array("RANGE", nominal.limits, shape="[RIG_AXES][2]")
    geometry.array("GAP", effects.plays, shape="[RIG_AXES]")
    profiles = [_profile(tables, one) for one in correction.remainder if one is not None]
    settled = append_add_remainder_if_any(tables, correction.extension, profiles)
    few = correction.deficient
    if few:
        count = hand_motion_direction_counts(nominal)
        geometry.lines.append(f"enum {{ POSITIONS = {count.position}, ROTATIONS = {count.rotation} }};")
    return CSource(
        joined_c_parts(
            *c_file_head_interface_and_constants(call, correction, effects, effects.plays, origin),
            c_source_part("arm"),
            "\n".join([*geometry.lines, *_chain("NOMINAL", nominal), *_chain("FITTED", fitted)]),
            *(c_source_part(name) for name in FIELDS if name in tables.parts),
            "\n".join(tables.lines),
            c_source_part("settle" if settled else "no remainder"),
            c_source_part("rotation vector"),
            c_source_part("arm kinematics"),
            c_source_part("arm of few joints" if few else "arm of six joints or more"),
            *effect_compensation_c_functions(effects),
            c_source_part("ranges"),
            c_source_part("arm correct"),
        ),
        effects.notes,
        effects.channels,
        effects.plays,
    )


def _chain(name: str, arm: Arm) -> list[str]:
    """Lines that define an arm's figures: rows of its links, base and tool."""
    return [
        f"static const struct chain {name} = {{",
        f"    {_braced(arm.rows)},",
        *(f"    {_placed(T)}," for T in (arm.base, arm.tool)),
        "};",
    ]


def _placed(T: RigidTransform) -> str:
    """A pose in C: {rotation, position}."""
    return f"{{{_braced(T.rotation.as_matrix())}, {_braced(T.translation)}}}"


def _braced(values: Floats) -> str:
    """Numbers in C, an array of arrays in braces each."""
    if np.ndim(values) == 0:
        return repr(float(values))
    return f"{{{', '.join(map(_braced, values))}}}"


def _profile(tables: CTables, profile: Profile) -> list[str]:
    """Name of the function that adds a joint's profile, its waves in tables."""
    waves = len(profile.orders)
    own = np.stack([profile.own[:waves], profile.own[waves:]], axis=1)
    arrays = {"orders": profile.orders, "own": own, "others": profile.others}
    return tables.structure("profile", (profile.axis, waves), arrays)
