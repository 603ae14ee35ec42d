"""What commands say of their user's mistakes before they begin: a recording is read, checked, and refused where its results would mean nothing."""

import argparse
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from rig.commands.output import read_recording
from rig.errors import FileError, RigError
from rig.mistakes.mistake import Mistake

if TYPE_CHECKING:
    from rig.recording import Corners, Recording


def argument(parser: argparse.ArgumentParser) -> None:
    """Add --anyway to a command that begins with a check."""
    parser.add_argument("--anyway", action="store_true", help="go on though the recording shows a mistake that makes results meaningless")


def loaded(arguments: argparse.Namespace) -> "Recording":
    """Recording of the arguments that `add_recording` adds. Raises RigError that names the likeliest mistake first where it cannot be read."""
    from rig.mistakes.unreadable import unreadable

    try:
        return read_recording(arguments)
    except FileError as error:
        causes = unreadable(arguments.recording, error)
        if not causes:
            raise
        raise RigError("\n".join([*map(str, causes), str(error)])) from None


def begin(arguments: argparse.Namespace) -> "tuple[Recording, Callable[[Corners], None]]":
    """(Recording, what looks at its corners once they are read): both refuse what is spoilt, unless anyway, and print what is unlikely.

    Raises RigError that names the likeliest mistake first
    """
    from rig.mistakes.early import early

    anyway = arguments.anyway
    recording = loaded(arguments)
    judge(early(recording), anyway)

    def look(corners: "Corners") -> None:
        from vision.mistakes import look as looked

        judge(looked(recording, corners), anyway)

    if recording.has_images and recording.corners is None and recording.design.targets:
        from vision.mistakes.images import misread

        judge(misread(recording), anyway)
    if recording.poses is not None and recording.corners is None and not recording.has_images:
        judge(of_poses(recording), anyway)
    return recording, look


def some_corners(recording: "Recording") -> "Corners | None":
    """Corners read in some frames' images; None where there are none."""
    if not recording.has_images or not recording.design.targets:
        return None
    from vision.mistakes.images import read

    return read(recording)[0]


def of_poses(recording: "Recording") -> tuple[Mistake, ...]:
    """Mistakes that poses.csv and commands.csv show of each other."""
    if recording.poses is None or recording.commands is None:
        return ()
    kind = recording.design.mechanism.kind
    if kind == "arm":
        from calib.mistakes import look

        return look(recording)
    if kind != "hexapod":
        return ()
    from rig.mistakes import in_order, motion

    return in_order(motion.mistakes(motion.of(recording, recording.poses.frame, recording.poses.T_base_platform, motion.written(recording))))


def judge(mistakes: Iterable[Mistake], anyway: bool) -> None:
    """Print what is unlikely, first of all; raise RigError with all of it where one makes results meaningless and nobody said anyway."""
    mistakes = tuple(mistakes)
    if any(one.spoils for one in mistakes) and not anyway:
        raise RigError("\n".join([*map(str, mistakes), "Nothing was computed; --anyway does it nevertheless"]))
    for one in mistakes:
        print(one)
    if mistakes:
        sys.stdout.flush()
