"""Checks of a recording before a command begins: load it, print mistakes, refuse it where results mean nothing."""

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import read_recording
from rig.cli.shared.terminal_output import Progress
from rig.errors import RigError

if TYPE_CHECKING:
    from rig.recording.recording_folder import Recording


def add_anyway_option(parser: argparse.ArgumentParser) -> None:
    """Add the option --anyway, which continues in spite of mistakes in the recording."""
    parser.add_argument(
        "--anyway",
        action="store_true",
        help="go on though the recording shows a mistake that makes results meaningless",
    )


def read_recordings(arguments: argparse.Namespace) -> "list[Recording]":
    """The Recordings of the arguments that `add_recordings` adds. Raises RigError for --mask with several"""
    if arguments.further and arguments.mask is not None:
        raise RigError(
            "--mask names frames of one recording; with several, mask them one by one (rig measure REC "
            "--mask FRAMES --out ..)"
        )
    return [read_recording(arguments, path) for path in (arguments.recording, *arguments.further)]


def print_notices(progress: Progress) -> Callable[[str], None]:
    """What prints a line that a computation hands out on its way, the progress bar taken away first."""

    def notice(line: str) -> None:
        progress.close()
        print(line, flush=True)

    return notice
