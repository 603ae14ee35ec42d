"""Poses from readings: of accepted measuring limbs (--limbs), or of a measuring machine (rig correct --forward)."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_whole_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from calib.online.measuring_limb_poses import LimbPoses
    from calib.online.measuring_limbs_file import Accepted
    from calib.samples.recording_samples import Sampled
    from rig.cli.shared.command_options import Progress
    from rig.model.design import Design
    from rig.recording.corner_and_pose_tables import Corners
    from rig.recording.recording_folder import Recording

EVERY = 5  # poses between two looks of vision


def add_limb_options(parser: ArgumentParser) -> None:
    """Add the limb options to a parser: --limbs FILE as the source of poses, --check N for vision checks."""
    parser.add_argument(
        "--limbs",
        metavar="FILE",
        type=Path,
        help="poses from measuring limbs that `rig insitu` accepted and saved here; "
        "vision checks some, and the acceptance is withdrawn where they no longer agree",
    )
    parser.add_argument(
        "--check",
        type=parse_whole_number,
        metavar="N",
        help=f"with --limbs: vision looks at every Nth pose at least (default {EVERY})",
    )


def vision_check_interval(arguments: Namespace) -> int:
    """Vision check interval, poses between two checks. Raises RigError for --check without --limbs, or below 1."""
    if arguments.check is not None and (arguments.limbs is None or arguments.check < 1):
        raise RigError("--check takes a number of poses, at least 1, and --limbs")
    return arguments.check or EVERY


def samples_by_limbs_or_vision(
    arguments: Namespace, recording: Recording, progress: Progress, look: Callable[[Corners], None] | None = None
) -> Sampled:
    """Samples of a recording, by limbs where --limbs names them, else by vision. look : as for `sample_recording`

    Raises RigError for limbs that were not accepted, that are others than rig.toml states, or with which vision no
        longer agrees
    """
    from calib.online import measuring_limb_poses
    from calib.samples.recording_samples import sample_recording

    if arguments.limbs is None:
        vision_check_interval(arguments)
        return sample_recording(recording, progress=progress, on_corners=look)
    found, accepted = checked_limb_poses(arguments, recording, progress)
    return replace(
        measuring_limb_poses.samples_of_limb_poses(recording, found),
        files=(arguments.limbs,),
        data=tuple(accepted.provenance.get("data", ())),
    )


def checked_limb_poses(arguments: Namespace, recording: Recording, progress: Progress) -> tuple[LimbPoses, Accepted]:
    """Checked limb poses: (LimbPoses, Accepted). Raises as `samples_by_limbs_or_vision`; the acceptance is"""
    from calib.online import measuring_limb_poses, measuring_limbs_file

    every = vision_check_interval(arguments)
    accepted = measuring_limbs_file.accepted_limbs(arguments.limbs, recording.design)
    found = measuring_limb_poses.limb_poses(recording, accepted)
    checked = measuring_limb_poses.check_limb_poses(recording, accepted, found, every, progress)
    progress.close()
    if checked.disagreement is not None and checked.frame is not None:
        write_withdrawal(arguments.limbs, accepted, str(recording.folder), checked.frame, checked.disagreement.reason)
        raise RigError(
            f"frame {checked.frame}: {checked.disagreement.reason}. {checked.disagreement.who}: their "
            "acceptance is withdrawn "
            f"in {arguments.limbs}, and nothing was computed; without --limbs vision measures"
        )
    spare = 0 if accepted.limbs.checks is None else len(accepted.limbs.checks.limbs)
    told = f", at each of which {spare} more limb{'s close' if spare > 1 else ' closes'}" if spare else ""
    print(
        f"{len(found.frames)} poses from the measuring limbs{told}; "
        + (
            f"vision looked at {checked.count} of them and agrees"
            if checked.count
            else "the recording has nothing for vision to look at, so that none was checked by it"
        )
    )
    return found, accepted


def accepted_limbs_for_run(arguments: Namespace, design: Design) -> Accepted:
    """Accepted limbs for a run, in place of vision. Raises RigError where nothing reads them or vision cannot check."""
    from calib.certify import measuring_limbs
    from calib.online import measuring_limbs_file

    if arguments.no_measure:
        raise RigError(
            "--limbs with --no-measure: vision must look at some poses, or a limb that slips is never noticed"
        )
    found = measuring_limbs_file.accepted_limbs(arguments.limbs, design)
    channels = measuring_limbs.stated_limbs(design).channels
    if design.sensors is None or set(channels) - set(design.sensors.channels):
        raise RigError(f"--limbs takes a [sensors] table in rig.toml with the channels {channels[0]} .. {channels[-1]}")
    return found


def write_withdrawal(path: Path, accepted: Accepted, recording: str, frame: int, reason: str) -> None:
    """Write the withdrawal of accepted limbs into their file. Raises FileError where that cannot be written."""
    from calib.online import measuring_limbs_file

    measuring_limbs_file.save_limbs(path, measuring_limbs_file.withdraw_acceptance(accepted, recording, frame, reason))


BEYOND = 0.05  # of an axis' range, by which a reading may lie beyond it


def write_poses_of_readings(arguments: Namespace) -> None:
    """Write the corrected poses of a measuring machine's readings, with covariance: summands of the opposite sign.

    Raises RigError for options that are about commands, and for what cannot be read
    Source: configuration-space patent, [0062], [0068] to [0072], [0131]
    """
    import numpy as np

    from calib.models.corrected_pose_covariance import corrected_pose_covariance
    from rig.formats import csv_table
    from rig.model import mechanisms
    from rig.recording import recording_tables
    from rig.recording.corner_and_pose_tables import Poses

    if arguments.uncorrected or arguments.single_step or arguments.skip_unreachable or arguments.sensors:
        raise RigError(
            "--uncorrected, --single-step, --skip-unreachable and --sensors are about commands for wanted "
            "poses, not about --forward"
        )
    calibration = calibration_and_effect_files.load_calibration(
        arguments.calibration, calibration_and_effect_files.load_effect_files(arguments)
    )
    correction, nominal = calibration.correction, calibration.correction.nominal
    kinematics = mechanisms.kinematics_of(nominal)
    rows = csv_table.read(arguments.forward, ("frame", *nominal.axes))
    readings, frames = rows.matrix(nominal.axes), rows.whole("frame")
    out = arguments.outputs.file(arguments.out)
    far = np.abs(kinematics.limits(readings, nominal)) > BEYOND * np.ptp(kinematics.travel(nominal), axis=1)
    if far.any():
        i, axis = np.argwhere(far)[0].tolist()
        rows.fail(f"{nominal.axes[axis]} is read beyond its range", i, nominal.axes[axis], readings[i, axis])
    T = correction.predict(readings)
    covariance = corrected_pose_covariance(calibration, T, readings)
    recording_tables.write_poses(out, Poses(frames, T, covariance))
    position, rotation = (
        float(np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2).mean()))
        for part in (slice(0, 3), slice(3, 6))
    )
    moved = np.linalg.norm(T.translation - kinematics.forward(readings, nominal).translation, axis=1)
    print(
        f"{len(frames)} poses written to {arguments.out}: {np.sqrt((moved**2).mean()) * 1e3:.4f} mm RMS from "
        "what the owner's model reads; "
        f"standard uncertainty {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad RMS"
    )
    if calibration.physics is not None:
        print("what the calibration knows of physics is not taken off readings: it depends on what went before them")
