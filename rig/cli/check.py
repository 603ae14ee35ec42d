"""rig check: check a recording for mistakes and print them, the likeliest cause first."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rig.checks.user_mistake import Mistake, sort_mistakes
from rig.cli.shared import recording_checks
from rig.cli.shared.command_options import add_json_option, print_json
from rig.errors import FileError

if TYPE_CHECKING:
    from rig.recording.recording_folder import Corners, Recording

CERTAIN = 0.7  # proof of a mistake in the files, from which nothing is learnt by looking farther


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument(
        "--detect",
        action="store_true",
        help="read some images even if corners.csv is there, and hold both against each other",
    )
    add_json_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Say all that is wrong or unlikely with a recording, the most likely cause first; 1 where results would mean
    nothing.
    """
    from rig.checks.recording_files import recording_file_mistakes
    from rig.checks.unreadable_recording import unreadable_recording_mistakes
    from rig.recording import recording_folder as recordings

    try:
        recording = recordings.load_recording(arguments.recording)
    except FileError as error:
        return _say(
            arguments,
            (
                *unreadable_recording_mistakes(arguments.recording, error),
                Mistake(str(error), "Mend this first: nothing else could be looked at"),
            ),
        )
    found = [*recording_file_mistakes(recording)]
    if any(one.spoils and one.proof >= CERTAIN for one in found):
        rest = Mistake("corners and poses were not looked at", "Mend what is wrong first and check again", False, 0.0)
        return _say(arguments, sort_mistakes([*found, rest]))
    found += recording_checks.pose_command_mistakes(recording)
    corners = recording.corners
    if recording.has_images and (corners is None or arguments.detect):
        from vision.checks.image_sample import read_corners_of_image_sample

        seen, more = read_corners_of_image_sample(recording)
        found += more
        corners = corners or seen
    if corners is not None:
        found += _looked(recording, corners)
    return _say(arguments, sort_mistakes(found), _remarks(recording))


def _looked(recording: "Recording", corners: "Corners") -> tuple[Mistake, ...]:
    from vision.checks import find_corner_mistakes

    return find_corner_mistakes(recording, corners, thorough=True)


def _remarks(recording: "Recording") -> tuple[str, ...]:
    """What could be better about the rig's cubes, in figures."""
    from vision.checks.cube_layout_remarks import cube_layout_remarks

    return cube_layout_remarks(recording.design)


def _say(arguments: argparse.Namespace, found: tuple[Mistake, ...], remarks: tuple[str, ...] = ()) -> int:
    spoilt = any(one.spoils for one in found)
    if arguments.json:
        print_json(
            {
                "schema": "check/1",
                "usable": not spoilt,
                "found": [asdict(one) for one in found],
                "remarks": list(remarks),
            }
        )
        return int(spoilt)
    for one in found:
        print(f"{'wrong' if one.spoils else 'to look at'}: {one}")
    if not found:
        print("nothing wrong or unlikely was found")
    for text in remarks:
        print(f"remark: {text}")
    return int(spoilt)
