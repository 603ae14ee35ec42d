"""Options of commands that read recordings: which frames, mistakes allowed, measuring limbs as the source of poses."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.terminal_output import Progress
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_whole_number

if TYPE_CHECKING:
    from calib.online.measuring_limb_poses import LimbSource
    from rig.recording.recording_folder import Recording

EVERY = 5  # poses between two checks by vision


def add_recording_argument(parser: ArgumentParser, text: str | None = None) -> None:
    """Add the recording argument REC, and the options that leave out frames or images. text : help, or None."""
    parser.add_argument("recording", metavar="REC", type=Path, help=text)
    _add_left_out(parser)


def add_recordings_argument(parser: ArgumentParser) -> None:
    """Add the arguments REC.., several recordings of one rig: `recording` is the first, `further` the others."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument(
        "further",
        metavar="REC",
        type=Path,
        nargs="*",
        help="more recordings of the same rig, in the order in which they were "
        "taken: days apart, with other payloads, cameras moved between them or not",
    )
    _add_left_out(parser)


def _add_left_out(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--skip-unreadable", action="store_true", help="leave out, and list, images that cannot be used"
    )
    parser.add_argument(
        "--mask", metavar="FRAMES", help="leave these frames out, for example 3,7-9: what you know to be spoilt"
    )


def read_recording(arguments: Namespace, path: Path | None = None) -> Recording:
    """Read a recording, by default that of the arguments; omitted images are named on standard error."""
    import rig

    found = rig.load(path or arguments.recording, arguments.skip_unreadable, arguments.mask)
    for image in found.skipped:
        print(f"left out, as asked: {image.path}: {image.problem}", file=sys.stderr)
    return found


def add_anyway_option(parser: ArgumentParser) -> None:
    """Add the option --anyway, which continues in spite of mistakes in the recording."""
    parser.add_argument(
        "--anyway",
        action="store_true",
        help="go on though the recording shows a mistake that makes results meaningless",
    )


def read_recordings(arguments: Namespace) -> list[Recording]:
    """The Recordings of the arguments that `add_recordings_argument` adds. Raises RigError for --mask with several"""
    if arguments.further and arguments.mask is not None:
        raise RigError(
            "--mask names frames of one recording; with several, mask them one by one (rig measure REC "
            "--mask FRAMES --out ..)"
        )
    return [read_recording(arguments, path) for path in (arguments.recording, *arguments.further)]


def notice_printer(progress: Progress) -> Callable[[str], None]:
    """Function that prints a notice line of a computation, the progress bar removed first."""

    def notice(line: str) -> None:
        progress.close()
        print(line, flush=True)

    return notice


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


def limb_source(arguments: Namespace) -> LimbSource | None:
    """Source of limb readings (--limbs) that replaces vision, None where the arguments name none. Raises RigError."""
    if arguments.check is not None and (arguments.limbs is None or arguments.check < 1):
        raise RigError("--check takes a number of poses, at least 1, and --limbs")
    if arguments.limbs is None:
        return None
    from calib.online.measuring_limb_poses import LimbSource

    return LimbSource(arguments.limbs, arguments.check or EVERY)
