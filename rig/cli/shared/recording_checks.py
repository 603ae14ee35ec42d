"""Checks of a recording before a command begins: load it, print mistakes, refuse it where results mean nothing."""

import argparse
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.checks.user_mistake import Mistake
from rig.cli.shared.command_options import read_recording
from rig.errors import FileError, RigError

if TYPE_CHECKING:
    from rig.cli.shared.command_options import Progress
    from rig.recording.recording_folder import Corners, Recording
    from vision.combined_recordings import CombinedRecordings


def add_anyway_option(parser: argparse.ArgumentParser) -> None:
    """Add the option --anyway, which continues in spite of mistakes in the recording."""
    parser.add_argument(
        "--anyway",
        action="store_true",
        help="go on though the recording shows a mistake that makes results meaningless",
    )


def load_recording(arguments: argparse.Namespace, path: Path | None = None) -> "Recording":
    """Load a recording, by default that of the arguments; where it is unreadable, the likeliest mistake is named.

    Raises RigError that names the likeliest mistake first where it cannot be read
    """
    from rig.checks.unreadable_recording import unreadable_recording_mistakes

    try:
        return read_recording(arguments, path)
    except FileError as error:
        causes = unreadable_recording_mistakes(path or arguments.recording, error)
        if not causes:
            raise
        raise RigError("\n".join([*map(str, causes), str(error)])) from None


def check_recording(recording: "Recording", anyway: bool) -> "Callable[[Corners], None]":
    """Check a recording's files, and return the check of its corners; each refuses mistakes unless anyway.

    Raises RigError that names the likeliest mistake first
    """
    _check_files(recording, anyway)

    def look(corners: "Corners") -> None:
        from vision.checks import find_corner_mistakes as looked

        report_mistakes(looked(recording, corners), anyway)

    return look


def load_and_check_recordings(
    arguments: argparse.Namespace, progress: "Progress"
) -> "tuple[Recording, Callable[[Corners], None], CombinedRecordings | None]":
    """Load and check recordings: (one Recording of them all, the check of its corners), each recording
    What is shared and what is each one's own is printed.

    Raises RigError that names the likeliest mistake first, and for recordings that are not of one rig
    """
    if not arguments.further:
        recording = load_recording(arguments)
        return recording, check_recording(recording, arguments.anyway), None
    if arguments.mask is not None:
        raise RigError(
            "--mask names frames of one recording; with several, mask them one by one (rig measure REC "
            "--mask FRAMES --out ..)"
        )
    from rig.recording.combined_recordings import is_measured_by_instrument
    from vision.combined_recordings import combine_recordings, require_combinable

    every = [load_recording(arguments, path) for path in (arguments.recording, *arguments.further)]
    require_combinable(every)
    for recording in every:
        _check_files(recording, arguments.anyway)
        corners = recording.corners if recording.corners is not None else corners_of_image_sample(recording)
        if corners is not None:
            from vision.checks import find_corner_mistakes as look

            report_mistakes(look(recording, corners), arguments.anyway)
    found = combine_recordings(every, progress)
    progress.close()
    print("\n".join(found.lines()), flush=True)
    recording = found.recording
    if is_measured_by_instrument(recording):
        if recording.design.mechanism.strut_joints is not None:
            from calib.drift.instrument_displacement import remove_instrument_displacement

            recording, places = remove_instrument_displacement(recording)
            print(
                "\n".join(place.line(every[place.recording].name) for place in places)
                or "the instrument stands where it stood",
                flush=True,
            )
        else:
            print("the instrument is taken to stand where it stood: of an arm that is not looked at", flush=True)
    return recording, lambda corners: None, found


def _check_files(recording: "Recording", anyway: bool) -> None:
    """Judge what a recording's files and some of its images show."""
    from rig.checks.recording_files import recording_file_mistakes
    from rig.model.cube_remounting import WORDS, quarter_turns

    report_mistakes(recording_file_mistakes(recording), anyway)
    for name, quarters in quarter_turns(recording.design).items():
        print(
            f"{recording.folder}: cube {name} was taken off and put back, {WORDS[quarters]}; its place is "
            "known only to what that may do, so its "
            "markers hold no pose",
            flush=True,
        )
    if recording.has_images and recording.corners is None and recording.design.targets:
        from vision.checks.image_sample import dictionary_and_identity_mistakes

        report_mistakes(dictionary_and_identity_mistakes(recording), anyway)
    if recording.poses is not None and recording.corners is None and not recording.has_images:
        report_mistakes(pose_command_mistakes(recording), anyway)


def corners_of_image_sample(recording: "Recording") -> "Corners | None":
    """Corners detected in a sample of a recording's images; None where there are no images or targets."""
    if not recording.has_images or not recording.design.targets:
        return None
    from vision.checks.image_sample import read_corners_of_image_sample

    return read_corners_of_image_sample(recording)[0]


def pose_command_mistakes(recording: "Recording") -> tuple[Mistake, ...]:
    """Mistakes visible from poses and commands together: where poses.csv and commands.csv contradict each other."""
    if recording.poses is None or recording.commands is None:
        return ()
    mechanism = recording.design.mechanism
    if mechanism.link_rows is not None:
        from calib.models.arm.command_and_pose_mistakes import find_arm_mistakes as look

        return look(recording)
    if mechanism.plates is None:
        return ()
    from rig.checks import platform_commands_and_poses, sort_mistakes

    return sort_mistakes(
        platform_commands_and_poses.command_pose_mistakes(
            platform_commands_and_poses.moves_of_recording(
                recording,
                recording.poses.frame,
                recording.poses.T_base_platform,
                platform_commands_and_poses.written_pose_columns(recording),
            )
        )
    )


def report_mistakes(mistakes: Iterable[Mistake], anyway: bool) -> None:
    """Report mistakes: print them, or raise RigError with all where one makes results meaningless, unless anyway."""
    mistakes = tuple(mistakes)
    if any(one.spoils for one in mistakes) and not anyway:
        raise RigError("\n".join([*map(str, mistakes), "Nothing was computed; --anyway does it nevertheless"]))
    for one in mistakes:
        print(one)
    if mistakes:
        sys.stdout.flush()
