"""Printed summaries of a measurement, of a calibration and of on-line learning."""

from collections.abc import Sequence

import numpy as np

from calib.api.calibrate import CalibrationResult
from calib.api.correction_extension_over_configuration_or_pose_space import ExtendedCorrection
from calib.api.measuring_limb_acceptance_and_poses_from_readings import MeasuredLimbPoses
from calib.api.parameter_learning_pose_by_pose_from_recording import LearningResult
from calib.certification import platform_certification
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, claim_lines
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.models.arm import arm_certification as arm_certification
from calib.models.arm.tilt_observations import tilt_report
from calib.models.chain import chain_certification_and_page as chain_certification
from calib.workspace.workspace_page import workspace_lines
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import (
    print_frames_without_pose,
    print_held_out_errors,
    printer_with_joint_names,
)
from rig.formats.numbers_and_units import count_text
from rig.model import mechanisms
from rig.model.pose import pose_to_vector, rms_uncertainty
from vision.api import MeasurementResult, camera_time_offset_and_readout_lines
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import NotHeldOut
from vision.bundle.marker_and_target_displacements import Places


def print_measurement(result: MeasurementResult) -> None:
    """Print the summary of a measurement.

    The verdict comes first.
    """
    print(result.verdict.line)
    _print_figures(result)
    print_frames_without_pose(result.measurement)
    _print_stages(result)
    if result.suspects:
        print(
            f"{len(result.suspects)} marker{'s are' if len(result.suspects) > 1 else ' is'} not what rig.toml "
            "states; disagreeing rows are excluded from the "
            "poses:"
        )
        for suspect in result.suspects:
            print(f"  {suspect}")
    if result.places:
        _print_places(result.places)
    _print_cameras(result)
    for line in (*result.clocks, *camera_time_offset_and_readout_lines(result.measurement)):
        print(line)
    if result.determination is not None:
        print(result.determination.summary())


def print_limb_pose_uncertainty_and_vision_agreement(poses_from_limbs: MeasuredLimbPoses) -> None:
    """Print the uncertainty of poses from measuring limbs, and their agreement with vision."""
    position, rotation = rms_uncertainty(poses_from_limbs.poses.covariance)
    print(
        f"poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad (standard uncertainty, RMS), of "
        "which readings "
        f"{rms_uncertainty(poses_from_limbs.poses.own)[0] * 1e3:.4f} mm, the limbs' geometry the rest; "
        "it agreed with vision "
        f"over {poses_from_limbs.accepted.agreement.n} poses"
    )


def print_online_learning_result(result: LearningResult, verdict_first: bool = True) -> None:
    """Print the result of on-line learning.

    verdict_first : whether the verdict leads
    """
    print("\n".join([*([result.verdict.line] if verdict_first else []), *result.found.lines]))
    print_frames_without_pose(result.sampled.measurement)


def _print_figures(result: MeasurementResult) -> None:
    """Print how much was measured and how well."""
    measured, held, (position, rotation) = result.measurement, result.held, result.uncertainty
    print(
        f"measured: {len(measured.frames)} of {result.frame_count} frames solved, poses to {position * 1e3:.4f} "
        f"mm and {rotation * 1e3:.4f} "
        "mrad "
        "(standard uncertainty, RMS)"
    )
    print(f"corners scatter by {measured.noise:.4f} px; {measured.inliers.sum()} of {len(measured.inliers)} used")
    print(
        f"held-out frames: residuals {held.ratio:.3f} +- {2 * held.scatter:.3f} of what the covariance predicts, "
        f"{held.rms:.3f} px RMS over {count_text(held.corners, 'corner')}"
        if not isinstance(held, NotHeldOut)
        else f"no held-out figure: {held.reason}"
    )


def _print_stages(result: MeasurementResult) -> None:
    """Print how many poses of a chain's stages there are and how well they are known."""
    for stage, own in result.measurement.stages.items():
        known = ""
        if len(own.frames):
            position, rotation = rms_uncertainty(own.covariance)
            known = f", poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad"
        print(f"stage {stage}: {len(own.frames)} of {result.frame_count} frames solved{known}: poses_stage{stage}.csv")


def _print_cameras(result: MeasurementResult) -> None:
    """Print how far each camera is from its stated pose."""
    for stated, camera in zip(result.recording.design.cameras, result.measurement.design.cameras):
        step = pose_to_vector(stated.pose.inv() * camera.pose)
        print(
            f"camera {camera.name}: {(step[:3] ** 2).sum() ** 0.5 * 1e3:.3f} mm and "
            f"{(step[3:] ** 2).sum() ** 0.5 * 1e3:.3f} mrad from "
            f"where rig.toml has it, focal length {camera.matrix[0, 0] - stated.matrix[0, 0]:+.2f} px"
        )


def _print_places(moved: Places) -> None:
    """Print what adjusting the markers' places did."""
    print(
        "places of the markers adjusted: x y z in mm, rx ry rz in mrad, along the marker's own axes, with 95 "
        "% intervals"
    )
    for move in moved.moves:
        values = [f"{by * 1e3:+8.3f} +- {half * 1e3:.3f}" for by, half in zip(move.by, move.ci95)]
        print(f"  {str(move.place):12} {'moved' if move.moved else 'stays'} " + " ".join(values))
    for name, value in (("as stated", moved.before), ("as adjusted", moved.after)):
        print(
            f"residual of the platform per frame, places {name}: median {np.median(value):.3f}, 95 % "
            f"{np.quantile(value, 0.95):.3f}, "
            f"max {value.max():.3f} px RMS per axis"
        )
    print(
        f"squares over degrees of freedom, all corners by their scatter: {moved.weighted[0]:.2f} as stated, "
        f"{moved.weighted[1]:.2f} as adjusted"
    )
    print(f"frames flipped against those before and after: {', '.join(map(str, moved.odd)) or 'none'}")


MOST_NAMED = 10  # frames


def print_calibration_verdict_errors_and_corrections(result: CalibrationResult) -> None:
    """Print the verdict of a calibration, then its held-out errors and corrections."""
    claim, done = result.calibration.claim, result.done
    print(
        "\n".join(
            [result.verdict.line, *result.verdict.rests_on, *(claim_lines(claim)[1:] if claim is not None else [])]
        )
    )
    if done.held_out:
        print_held_out_errors(done.held_out, _held_out_title(result))
    if result.extended is not None:
        _print_extension(result.extended)
    elif isinstance(done, arm_certification.CertifiedArm):
        _print_joints(done, result.calibration.physics, result.recording.design.joint_names)
        print("\n".join([*done.found.rank.report(), *tilt_report(result.samples.tilts, done.found.tilts)]))
        if result.pointing_terms is not None:
            print("\n".join(result.pointing_terms.report()))
    elif isinstance(done, chain_certification.CertifiedChain):
        print("\n".join(done.found.report()))
    else:
        _print_struts(done, result.calibration.physics)
    for clocks in result.clocks:
        print(f"taken into account: {clocks}")
    _print_pose_counts(result)


def print_calibration(result: CalibrationResult, promise: float | None) -> None:
    """Print the summary of a calibration.

    Confounds, promise, workspace and frames without a pose.
    promise : m, whether it is kept
    """
    calibration = result.calibration
    if calibration.confounds is not None:
        print(calibration.confounds.line())
    _print_promise(promise, calibration.claim)
    _print_workspace(calibration)
    print_frames_without_pose(result.sampled.measurement)


def _held_out_title(result: CalibrationResult) -> str:
    """How poses were held out."""
    if result.extended is not None:
        return "held-out poses (whole levels of a grid, poses next to it, or whole stretches in turn)"
    if isinstance(result.done, arm_certification.CertifiedArm):
        return "held-out poses (a third at a time or less, whole stretches of configurations)"
    return "held-out poses (whole stretches of configurations in turn)"


def _print_struts(done: platform_certification.Certified, physics: Physics | None) -> None:
    """Print what a platform's correction does beyond its geometry."""
    struts = [i + 1 for i, part in enumerate(done.correction.remainder) if part is not None]
    print(
        "beyond the geometry: "
        + (
            f"struts {', '.join(map(str, struts))} corrected over the configuration space"
            if struts
            else "nothing that improves held-out poses"
            if done.held_out
            else "not tested, for lack of held-out poses"
        )
    )
    _print_physics(physics)


LISTED = 8  # vertices without a pose that are printed at most


def _print_extension(found: ExtendedCorrection) -> None:
    """Print what was tried and what was made of it."""
    for one in found.tried:
        words = f"not tried: {one.reason}" if one.reason else "not held out, for lack of poses"
        if one.held_out is not None:
            turned = one.held_out.after.rotation[0]
            words = f"held out {one.held_out.after.position[0] * 1e3:.4f} mm" + (
                f", {turned * 1e3:.4f} mrad RMS" if turned == turned else " RMS"
            )
            words += f"; not chosen: {one.reason}" if one.reason else ""
        print(f"{'->' if one.chosen else '  '} {one.kind:10} {words}")
    correction = found.done.correction
    field = correction.extension
    count = len(getattr(field, "values", ())) - len(found.lost) if field is not None and field.exact else 0
    for held in correction.posed:
        print(f"a map in pose space: {held.field.kind}")
    print(
        f"KSF over the whole configuration space: {'none' if field is None else field.kind}, on {found.base}"
        + (f"; exact at its {count} samples" if count else "")
    )
    for line in found.remarks:
        print(line)
    if len(found.lost):
        print(
            f"{len(found.lost)} of the grid's {count + len(found.lost)} vertices were not measured; corrections there "
            "are estimated from the other vertices, and less certain:"
        )
        print("\n".join("  " + " ".join(f"{value:.6g}" for value in row) for row in found.lost[:LISTED]))
        if len(found.lost) > LISTED:
            print(f"  and {len(found.lost) - LISTED} more")
    rms, most = (f"{value * 1e6:.3f} u{found.unit.replace(' or ', ' or u')}" for value in found.misses)
    print(
        f"the single step X + KSF(X) misses the fixed point, which `rig correct` solves for, by {rms} RMS, "
        f"{most} at most"
    )


def _print_promise(promise: float | None, claim: Claim | None) -> None:
    """Print whether a promise (m) is met by the upper end of the claim; nothing where none was made."""
    if promise is None or claim is None:
        return
    if claim.after is None:
        print(f"the promise of {promise * 1e6:.4g} um cannot be confirmed as met: {claim.reason}")
        return
    middle, _, most = claim.after[0]
    met = (
        "is met"
        if most <= promise
        else "is NOT met yet; rig plan --promise --given the recording names the next best poses"
    )
    print(
        f"the promise of {promise * 1e6:.4g} um {met}: {middle * 1e6:.4g} um RMS over the workspace, "
        f"{most * 1e6:.4g} at most (97.5 %)"
    )


def _print_workspace(calibration: Calibration) -> None:
    """Print what a calibration does to the workspace; nothing where that was not worked out."""
    if calibration.workspace is not None:
        print(workspace_lines(calibration.workspace, mechanisms.travel_unit(calibration.correction.nominal))[0])


def _print_joints(done: arm_certification.CertifiedArm, physics: Physics | None, joint_names: Sequence[str]) -> None:
    """Print what an arm's correction does beyond its geometry, and what that is worth on the held-out poses."""
    if done.held_out and done.geometry and done.scattered:
        retained = [i + 1 for i, part in enumerate(done.correction.remainder) if part is not None]
        bare = done.geometry.after.mean
        left, left_unit = (bare[0], "mm") if bare[0] == bare[0] else (bare[1], "mrad")
        beyond = [
            *(
                ["the identified effects, refitted without the held-out poses"]
                if physics is not None and physics.effects
                else []
            ),
            *([f"joints {', '.join(map(str, retained))} corrected over the configuration space"] if retained else []),
        ]
        print(
            "beyond the geometry: "
            + (
                f"{' and '.join(beyond)}; the geometry alone leaves {left * 1e3:.4f} {left_unit} mean on the same poses"
                if beyond
                else "nothing that improves held-out poses"
            )
        )
        flattered = done.scattered.after
        placed = flattered.mean[0] == flattered.mean[0]
        mean, rms, unit = (
            (flattered.mean[0], flattered.position[0], "mm")
            if placed
            else (flattered.mean[1], flattered.rotation[0], "mrad")
        )
        print(
            f"the same with single rows held out at random, which is optimistic: {mean * 1e3:.4f} {unit} mean, "
            f"{rms * 1e3:.4f} {unit} RMS"
        )
    _print_physics(physics, joint_names)


def _print_physics(physics: Physics | None, joint_names: Sequence[str] = ()) -> None:
    """Print which of the physics that a calibration knows its commands undo; nothing where it knows none."""
    if physics is None:
        return

    print_line = printer_with_joint_names(joint_names)
    repeated, sizeless = physics.compensable_effects(), physics.sizeless_effects()
    known = [f"{e.label()} at {e.place}" for e in repeated]
    print_line("effects compensated by commands: " + (", ".join(known) or "none"))
    if sizeless:
        named = ", ".join(f"{e.label()} at {e.place}" for e in sizeless)
        print_line(f"found, and of no size where the geometry is fitted with it, so that no command changes: {named}")
    left = [f"{e.label()} at {e.place}" for e in physics.effects if e not in (*repeated, *sizeless)]
    if left:
        print_line(f"removed from the measurements, and not the commands' to undo: {', '.join(left)}")
    for u in physics.unknown:
        print_line(u.sentence())


def _print_pose_counts(result: CalibrationResult) -> None:
    """Print how many poses of how many configurations there are, how many agree with one geometry, and which frames do
    not.
    """
    sampled, done = result.sampled, result.done
    odd = [str(frame) for frame in sampled.samples.frame[~done.found.inliers]]
    named = (
        f"; not frame {', '.join(odd[:MOST_NAMED])}"
        + (f" and {len(odd) - MOST_NAMED} more" if len(odd) > MOST_NAMED else "")
        if odd
        else ""
    )
    print(
        f"{count_text(len(sampled.samples), 'pose')} of "
        f"{count_text(done.label.max() + 1, 'distinct configuration')} from "
        f"{sampled.source}, {done.found.inliers.sum()} of "
        f"them agree with one geometry{named}"
    )
