"""rig verify: verify a calibration.

By another recording.
One not used for it: error before and after correction.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import escaped_output_progress_error_table_and_refutations, input_file_options_and_loading
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import (
    Progress,
    print_frames_without_pose,
    print_held_out_errors,
)
from rig.cli.shared.input_file_options_and_loading import add_recording_argument, read_recording
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_hand_option,
    add_json_option,
    add_page_option,
    page_links,
    page_path,
    print_json,
    recording_of_chosen_hand,
)
from rig.formats.numbers_and_units import count_text
from rig.report.verdict_refutations_and_result_display import exit_status

if TYPE_CHECKING:
    from calib.api.verify_and_watch import VerificationResult
    from rig.recording.corner_and_pose_csv_tables import Poses
    from rig.recording.recording_folder import Recording


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig verify` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    add_recording_argument(parser)
    add_json_option(parser)
    add_page_option(parser)
    add_hand_option(parser)
    input_file_options_and_loading.add_user_effect_files_option(parser)
    parser.add_argument(
        "--wanted", metavar="FILE", type=Path, help="poses that the recording's frames, in order, were intended to take"
    )


def run(arguments: Namespace) -> int:
    """Run `rig verify`.

    Verify a calibration by another recording and print its errors.

    Exit status 3 where the verdict is bad.
    """
    from calib.api.verify_and_watch import verify
    from rig.report.verdict_refutations_and_result_display import refutations_of_file

    progress = Progress()
    progress("reading the recording", 0, 1)
    calibration = input_file_options_and_loading.calibration_of_arguments(arguments)
    recording, page = recording_of_chosen_hand(arguments, read_recording(arguments)), page_path(arguments)
    wanted = _wanted_poses(arguments.wanted, recording)
    refuted = refutations_of_file(arguments.calibration)
    result = verify(calibration, recording, wanted, refuted, progress)
    progress.close()
    escaped_output_progress_error_table_and_refutations.print_refutations(arguments.calibration, refuted)
    if page is not None:
        result.write_page(page, page_links(arguments, arguments.page))
    if result.refutation is not None:
        escaped_output_progress_error_table_and_refutations.write_refutation(
            arguments, arguments.calibration, recording.name, result.refutation
        )
    if arguments.json:
        print_json(result.tree())
        return exit_status(result.verdict)
    _print_result(result)
    if page is not None:
        print(f"written: {arguments.page}")
    return exit_status(result.verdict)


def _wanted_poses(path: Path | None, recording: Recording) -> Poses | None:
    """Poses that a recording's frames were intended to take. Raises RigError where it shows several hands."""
    from rig.model.arm_hands_effect_places_and_tolerances import hand_names, selected_hand_name
    from rig.recording.corner_and_pose_csv_tables import load_poses
    from rig.recording.frame_selection_and_content_hashes import require_one_hand_shown

    if path is None:
        return None
    require_one_hand_shown(recording)
    mechanism = recording.design.mechanism
    return load_poses(path, are_commands=True, hands=hand_names(mechanism), hand=selected_hand_name(mechanism))


def _print_result(result: VerificationResult) -> None:
    """Print what was found, the verdict first."""
    shown = result.figures
    if shown.same:
        print(
            f"warning: the calibration was made from {len(shown.same)} of this recording's "
            f"{len(result.recording.exposures.times()[0])} frames, so these "
            "figures are not held out",
            file=sys.stderr,
        )
    print(result.verdict.line)
    for line in shown.displacement:
        print(line)
    if shown.driven is None:
        print_held_out_errors(shown.held, f"{count_text(len(shown.samples), 'pose')} from {result.sampled.source}")
        if shown.found is not None and shown.found.parts:
            print(
                "a machine error would have been detected from "
                + " and ".join(
                    f"{part.noticed * 1e3:.4f} {'mm' if name == 'position' else 'mrad'} RMS on"
                    for name, part in shown.found.parts.items()
                )
            )
    else:
        figures, stated, _ = shown.driven
        turned = ("", "", "")
        if 0 < stated[1] < float("inf"):  # the machine turns at all, and that was measured
            turned = (
                f"; rotation {figures.rotation[0] * 1e3:.4f} mrad RMS, {figures.rotation[2] * 1e3:.4f} max",
                f" and {stated[1] * 1e3:.4f} mrad",
                f" and {figures.rotation[0] / stated[1]:.2f}",
            )
        print(
            f"{figures.n} measured poses, against the wanted poses: position "
            f"{figures.position[0] * 1e3:.4f} mm RMS, "
            f"{figures.position[2] * 1e3:.4f} max{turned[0]}"
        )
        print(
            "stated standard uncertainty of that, calibration and measurement combined: "
            f"{stated[0] * 1e3:.4f} mm{turned[1]}: "
            f"the error is {figures.position[0] / stated[0]:.2f}{turned[2]} times it"
        )
    if shown.conflict is not None:
        print(shown.conflict.line())
    print_frames_without_pose(result.sampled.measurement)
    if shown.confounds is not None:
        print(shown.confounds.line())
