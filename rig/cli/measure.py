"""rig measure: measure platform poses with covariance from a recording's images; cameras adjusted."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.cli.shared import poses_from_readings, recording_checks
from rig.cli.shared.command_options import (
    Progress,
    add_json_result_option,
    add_overwrite_option,
    add_recording_argument,
    page_links,
    print_frames_without_pose,
)
from rig.errors import RigError
from rig.formats.input_files import read_bytes, read_text

if TYPE_CHECKING:
    from calib.report.measurement_page import MeasurementResult
    from rig.model.design import Camera
    from rig.recording.recording_folder import Recording
    from vision.recording_adjustment import Measurement


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recording_argument(parser)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="gets poses.csv, corners.csv, rig.toml and report.html"
    )
    parser.add_argument(
        "--hold", metavar="WHAT", default="", help="hold 'poses', 'lenses' or 'poses,lenses' of the cameras as stated"
    )
    parser.add_argument(
        "--places",
        choices=("auto", "stated", "free"),
        default="auto",
        help="places of the markers on their bodies: as stated, "
        "adjusted too, or (auto) adjusted where the stated ones contradict what is seen",
    )
    parser.add_argument("--detect", action="store_true", help="read the images even if corners.csv is there")
    poses_from_readings.add_limb_options(parser)
    add_overwrite_option(parser)
    recording_checks.add_anyway_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Measure a recording and write what was measured."""
    from rig.formats.rig_toml.design_text_edits import replace_cameras, replace_target_markers
    from rig.recording import frame_content_hashes, recording_tables
    from rig.recording import recording_folder as recordings

    free, progress = _free(arguments.hold), Progress()
    progress("reading the recording", 0, 1)
    poses_from_readings.vision_check_interval(arguments)
    recording = recording_checks.load_recording(arguments)
    if arguments.limbs is not None:
        recording_checks.check_recording(recording, arguments.anyway)
        _by_limbs(arguments, recording, progress)
        return
    with frame_content_hashes.start_content_hashing(recording) as marks:
        look = recording_checks.check_recording(recording, arguments.anyway)
        out = arguments.outputs.folder(arguments.out)
        arguments.outputs.data = frame_content_hashes.hash_lines(marks())

    from calib.report.measurement_page import MeasurementResult, write_measurement_page
    from vision.bundle.adjustment_validation import crossvalidate_adjustment, determined_combinations
    from vision.bundle.marker_displacements import adjusted_markers, compare_stated_and_adjusted_places
    from vision.hand_mounted_cameras import has_hand_cameras, invert_measured_poses, recording_seen_from_hand
    from vision.reading.marker_identity import find_suspicious_markers
    from vision.reading.recording_corners import image_reader
    from vision.recording_measurement import measure_recording
    from vision.targets import marker_map

    measured, collected = measure_recording(recording, free, arguments.detect, progress, arguments.places, look)
    held, determination = (
        crossvalidate_adjustment(measured.used(), measured.adjustment),
        determined_combinations(measured.adjustment),
    )
    moved = (
        compare_stated_and_adjusted_places(measured, recording.exposures.times()[1]) if measured.places_free else None
    )
    seen, as_seen = recording_seen_from_hand(recording), measured
    if has_hand_cameras(recording.design):
        as_seen, determination = invert_measured_poses(measured), determination.from_the_hand()
    look_at = image_reader(seen) if any(recording.exposures.image) else None
    wrong = find_suspicious_markers(as_seen, marker_map(seen.design), collected.repeated if collected else (), look_at)
    text = replace_cameras(read_text(recording.folder / "rig.toml"), measured.design.cameras)
    recording_tables.write_text(
        out / "rig.toml", replace_target_markers(text, adjusted_markers(measured)) if moved else text
    )
    poses = recordings.Poses(measured.frames, measured.T_base_platform, measured.covariance)
    recording_tables.write_poses(out / "poses.csv", poses)
    recording_tables.write_poses_as_roll_pitch_yaw(out / "rpy.csv", poses)
    recording_tables.write_corners(out / "corners.csv", measured.corners())
    recording_tables.copy_frames_commands_and_sensors(recording.folder, out, recording.exposures, recording.origin)
    told = MeasurementResult(recording, measured, held, collected, moved, determination.lines(), wrong)
    write_measurement_page(out / "report.html", told, page_links(arguments, arguments.out / "report.html"))
    _print_result(arguments, told, out)
    print(determination.summary())
    print(
        f"written: {arguments.out}/poses.csv, rpy.csv (roll, pitch, yaw), corners.csv, rig.toml; look at "
        f"{arguments.out}/report.html"
    )


def _print_result(arguments: Namespace, told: MeasurementResult, out: Path) -> None:
    """Print what was measured, the verdict first, and state it as what --json prints; the poses of a chain's stages are
    written to a folder.
    """
    from calib.report.measurement_page import measurement_verdict
    from calib.samples.pose_samples import rms_uncertainty

    recording, measured, verdict = told.recording, told.measurement, measurement_verdict(told)
    uncertainties, total = rms_uncertainty(measured.covariance), len(recording.exposures.times()[0])
    arguments.result = _result(recording, measured, told.held, uncertainties) | {"verdict": verdict.tree()}
    print(verdict.line)
    _print_verdict(measured, told.held, uncertainties, total)
    print_frames_without_pose(measured)
    _stages(out, measured, total)
    if told.suspects:
        print(
            f"{len(told.suspects)} marker{'s are' if len(told.suspects) > 1 else ' is'} not what rig.toml "
            "says; what disagrees is left out of the "
            "poses:"
        )
        for suspect in told.suspects:
            print(f"  {suspect}")
    if told.places:
        _print_places(told.places)
    _print_cameras(recording.design.cameras, measured.design.cameras)


def _stages(out: Path, measured: Measurement, total: int) -> None:
    """Write the poses of a chain's stages below the last that carry targets, and say how many there are and how well
    they are known.
    """
    from calib.samples.pose_samples import rms_uncertainty
    from rig.recording import recording_tables
    from rig.recording.corner_and_pose_tables import Poses

    for stage, own in measured.stages.items():
        recording_tables.write_poses(
            out / f"poses_stage{stage}.csv", Poses(own.frames, own.T_base_platform, own.covariance)
        )
        worth = ""
        if len(own.frames):
            position, rotation = rms_uncertainty(own.covariance)
            worth = f", poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad"
        print(f"stage {stage}: {len(own.frames)} of {total} frames solved{worth}: poses_stage{stage}.csv")


def _free(hold: str) -> tuple[str, ...]:
    """What of the cameras is adjusted. Raises RigError for what --hold does not take"""
    held, known = {part.strip() for part in hold.split(",") if part.strip()}, {"poses", "lenses"}
    if held - known:
        raise RigError(f"--hold takes 'poses' and 'lenses', not {', '.join(sorted(held - known))!r}")
    return tuple(sorted(known - held))


def _by_limbs(arguments: Namespace, recording: Recording, progress: Progress) -> None:
    """Write the poses that measuring limbs tell, with covariance; rig.toml stays as stated, since no camera was
    adjusted.
    """
    from calib.samples.pose_samples import rms_uncertainty
    from rig.recording import frame_content_hashes, recording_tables
    from rig.recording.corner_and_pose_tables import Poses

    if arguments.hold or arguments.detect or arguments.places != "auto":
        raise RigError("--hold, --places and --detect are about cameras and what they see; leave them out with --limbs")
    found, accepted = poses_from_readings.checked_limb_poses(arguments, recording, progress)
    out = arguments.outputs.folder(arguments.out)
    arguments.outputs.data = frame_content_hashes.hash_lines(frame_content_hashes.content_hashes(recording))
    recording_tables.write_bytes(out / "rig.toml", read_bytes(recording.folder / "rig.toml"))
    poses = Poses(found.frames, found.T_base_platform, found.covariance)
    recording_tables.write_poses(out / "poses.csv", poses)
    recording_tables.write_poses_as_roll_pitch_yaw(out / "rpy.csv", poses)
    recording_tables.copy_frames_commands_and_sensors(recording.folder, out, recording.exposures, recording.origin)
    position, rotation = rms_uncertainty(found.covariance)
    print(
        f"poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad (standard uncertainty, RMS), of "
        "which readings "
        f"{rms_uncertainty(found.own)[0] * 1e3:.4f} mm, the limbs' geometry the rest; it agreed with vision "
        f"over {accepted.agreement.n} poses"
    )
    print(f"written: {arguments.out}/poses.csv, rpy.csv (roll, pitch, yaw), rig.toml as stated")


def _result(
    recording: Recording, measured: Measurement, held: Any, uncertainties: tuple[float, float]
) -> dict[str, Any]:
    """What --json prints. uncertainties : m and rad"""
    from rig.model.pose import pose_to_vector

    pairs = zip(recording.design.cameras, measured.design.cameras)
    cameras = [
        {
            "name": camera.name,
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            "moved": pose_to_vector(stated.pose.inv() * camera.pose).tolist(),
        }
        for stated, camera in pairs
    ]
    return {
        "schema": "measured/1",
        "frames": len(recording.exposures.times()[0]),
        "solved": len(measured.frames),
        "unsolved": {str(frame): reason for frame, reason in measured.unsolved.items()},
        "position_m": uncertainties[0],
        "rotation_rad": uncertainties[1],
        "corner_px": float(measured.noise),
        "corners": len(measured.inliers),
        "used": int(measured.inliers.sum()),
        "held_out": {"ratio": held.ratio, "rms_px": held.rms} if held else None,
        "cameras": cameras,
    }


def _print_verdict(measured: Measurement, held: Any, uncertainties: tuple[float, float], total: int) -> None:
    """Print how much was measured and how well, the rest follows."""
    print(
        f"measured: {len(measured.frames)} of {total} frames solved, poses to {uncertainties[0] * 1e3:.4f} "
        f"mm and {uncertainties[1] * 1e3:.4f} "
        "mrad "
        "(standard uncertainty, RMS)"
    )
    print(f"corners scatter by {measured.noise:.4f} px; {measured.inliers.sum()} of {len(measured.inliers)} used")
    print(
        f"held-out frames: residuals {held.ratio:.3f} +- {2 * held.scatter:.3f} of what the covariance predicts, "
        f"{held.rms:.3f} px RMS over {held.corners} corners"
        if held
        else f"no held-out figure: {held.reason}"
    )


def _print_cameras(stated_cameras: tuple[Camera, ...], cameras: tuple[Camera, ...]) -> None:
    """Print how far each camera stands from where its owner has it."""
    from rig.model.pose import pose_to_vector

    for stated, camera in zip(stated_cameras, cameras):
        step = pose_to_vector(stated.pose.inv() * camera.pose)
        print(
            f"camera {camera.name}: {(step[:3] ** 2).sum() ** 0.5 * 1e3:.3f} mm and "
            f"{(step[3:] ** 2).sum() ** 0.5 * 1e3:.3f} mrad from "
            f"where rig.toml has it, focal length {camera.matrix[0, 0] - stated.matrix[0, 0]:+.2f} px"
        )


def _print_places(moved: Any) -> None:
    """Print what adjusting the markers' places did."""
    import numpy as np

    print(
        "places of the markers adjusted: x y z in mm, rx ry rz in mrad, along the marker's own axes, with 95 "
        "% intervals"
    )
    for move in moved.moves:
        values = [f"{by * 1e3:+8.3f} +- {half * 1e3:.3f}" for by, half in zip(move.by, move.ci95)]
        print(f"  {move.name:12} {'moved' if move.moved else 'stays'} " + " ".join(values))
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
