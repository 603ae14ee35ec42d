"""rig measure: measure platform poses from images.

Of a recording, with covariance; cameras are adjusted.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.input_file_options_and_loading import (
    add_continue_despite_mistakes_option,
    add_limb_options,
    add_recording_argument,
    limb_source,
    notice_printing_function,
    read_recording,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_hand_option,
    add_json_result_option,
    add_overwrite_option,
    page_links,
    recording_of_chosen_hand,
)
from rig.errors import RigError

if TYPE_CHECKING:
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource
    from rig.recording.recording_folder import Recording


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig measure` to a parser."""
    add_recording_argument(parser)
    add_hand_option(parser)
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
        "adjusted too, or (auto) adjusted where the stated ones contradict the observations",
    )
    parser.add_argument("--detect", action="store_true", help="read the images even if corners.csv exists")
    add_limb_options(parser)
    add_overwrite_option(parser)
    add_continue_despite_mistakes_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig measure`.

    Measure platform poses from a recording and write them.
    """
    progress = Progress()
    progress("reading the recording", 0, 1)
    hold, limbs = _hold(arguments.hold), limb_source(arguments)
    recording = recording_of_chosen_hand(arguments, read_recording(arguments))
    if limbs is not None:
        return _by_limbs(arguments, recording, limbs, progress)
    from calib.report.measurement_page import write_measurement_page
    from rig.cli.shared.measurement_calibration_and_learning_summary_printing import print_measurement
    from rig.recording import frame_selection_and_content_hashes
    from vision.api import MeasureOptions, measure

    out, options = (
        arguments.outputs.folder(arguments.out),
        MeasureOptions(hold, arguments.places, arguments.detect, arguments.anyway),
    )
    with frame_selection_and_content_hashes.hash_frame_contents_in_background(recording) as marks:
        result = measure(recording, options, progress, notice_printing_function(progress))
        arguments.outputs.data = frame_selection_and_content_hashes.manifest_lines_of_frame_hashes(marks())
    result.write(out)
    write_measurement_page(out / "report.html", result, page_links(arguments, arguments.out / "report.html"))
    arguments.result = result.tree()
    print_measurement(result)
    print(
        f"written: {arguments.out}/poses.csv, rpy.csv (roll, pitch, yaw), corners.csv, rig.toml; look at "
        f"{arguments.out}/report.html"
    )


def _hold(text: str) -> tuple[str, ...]:
    """What of the cameras remains as stated. Raises RigError for what --hold does not take"""
    held, known = {part.strip() for part in text.split(",") if part.strip()}, {"poses", "lenses"}
    if held - known:
        raise RigError(f"--hold takes 'poses' and 'lenses', not {', '.join(sorted(held - known))!r}")
    return tuple(sorted(held))


def _by_limbs(arguments: Namespace, recording: Recording, limbs: LimbSource, progress: Progress) -> None:
    """Write the poses of measuring limbs, with covariance; rig.toml remains as stated, since no camera was adjusted."""
    if arguments.hold or arguments.detect or arguments.places != "auto":
        raise RigError("--hold, --places and --detect apply to cameras and what they see; omit them with --limbs")
    from calib.api.measuring_limb_acceptance_and_poses_from_readings import measure_poses_by_limbs
    from rig.cli.shared.measurement_calibration_and_learning_summary_printing import (
        print_limb_pose_uncertainty_and_vision_agreement,
    )
    from rig.recording import frame_selection_and_content_hashes

    out = arguments.outputs.folder(arguments.out)
    found = measure_poses_by_limbs(recording, limbs, arguments.anyway, progress, notice_printing_function(progress))
    arguments.outputs.data = frame_selection_and_content_hashes.manifest_lines_of_frame_hashes(
        frame_selection_and_content_hashes.content_hashes_of_frames(recording)
    )
    found.write(out)
    print_limb_pose_uncertainty_and_vision_agreement(found)
    print(f"written: {arguments.out}/poses.csv, rpy.csv (roll, pitch, yaw), rig.toml as stated")
