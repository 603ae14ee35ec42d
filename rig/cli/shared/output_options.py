"""What the commands share: where results go, and figures in mm and mrad."""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.progress_bars import Progress
from rig.errors import MissingLibrary, RigError
from rig.formats.number_parsing import parse_number
from rig.formats.output_files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from calib.certify.platform_certification import HeldOut
    from rig.recording.recording_folder import Recording
    from rig.report.pages.page_template import Link
    from vision.recording_adjustment import Measurement

__all__ = [
    "SEED",
    "Progress",
    "add_driving",
    "add_overwrite_option",
    "add_json",
    "add_page",
    "add_port",
    "add_recording",
    "add_recordings",
    "add_result",
    "file_or_stdout",
    "parse_length",
    "page_links",
    "missing_drawing_reason",
    "parse_numbers",
    "page_path",
    "print_comparison",
    "print_json",
    "print_unsolved",
    "read_recording",
    "require_drawing",
]

SEED = 0  # of the bootstrap; results are the same from run to run


def add_recording(parser: ArgumentParser, text: str | None = None) -> None:
    """Add REC, a recording whose images are read, and what is done about those that cannot be. text : help about it, or
    None.
    """
    parser.add_argument("recording", metavar="REC", type=Path, help=text)
    _add_left_out(parser)


def add_recordings(parser: ArgumentParser) -> None:
    """Add REC.., recordings of one rig, and what is left out of them; `recording` is the first of these, `further` the
    others.
    """
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
    """The Recording at a path, by default the one of the arguments that `add_recording` adds; images left out are named
    on standard error.
    """
    from rig.recording import recording_folder as recordings
    from rig.recording.frame_mask import remove_frames

    found = recordings.load(path or arguments.recording, arguments.skip_unreadable)
    for image in found.skipped:
        print(f"left out, as asked: {image.path}: {image.problem}", file=sys.stderr)
    return found if arguments.mask is None else remove_frames(found, arguments.mask)


def file_or_stdout(text: str) -> Path:
    """The path of a file to write, as given on the command line: `-` is the standard output."""
    return STANDARD_OUTPUT if text == "-" else Path(text)


def add_overwrite_option(parser: ArgumentParser, name: str = "--force") -> None:
    """Let a command that writes be told to write over what it did not make. name : of that option, where --force is
    taken
    """
    parser.add_argument(
        name,
        dest="overwrite",
        action="store_true",
        help="write over what this command did not make; what it reads it never writes over",
    )


def add_page(parser: ArgumentParser) -> None:
    """Let a command write a page of its result."""
    parser.add_argument(
        "--page", metavar="FILE", type=Path, help="a page of it, written here: one file that needs no network"
    )


def page_path(arguments: Namespace) -> Path | None:
    """Where the page that `add_page` asks for is written, None where none is. Raises RigError where it cannot be."""
    return None if arguments.page is None else arguments.outputs.file(arguments.page)


def page_links(arguments: Namespace, place: Path) -> list[Link]:
    """Links of a page that will be at a place: to the index above it and to the pages of what the command reads."""
    from rig.report.pages.page_index import page_links as links

    return links(place, arguments.outputs.inputs)


def add_json(parser: ArgumentParser) -> None:
    """Let a command print its result for programs."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON (SI units, rad) instead of words")


def add_result(parser: ArgumentParser) -> None:
    """Let a command, which leaves it in `arguments.result` as plain values, print its result for programs once all is
    written.
    """
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the result as JSON (SI units, rad) when all is done; words go to the error output",
    )
    parser.set_defaults(result=None)


def print_json(tree: object) -> None:
    """Print a result for programs; figures that are not numbers are null."""
    import json

    from rig.formats.json_file import nan_to_null

    print(json.dumps(nan_to_null(tree), indent=1))


def parse_length(text: str) -> float:
    """m of a length as written on the command line: 20um, 0.02mm or 2e-5m. Raises ArgumentTypeError for anything
    else.
    """
    for unit, scale in (("um", 1e-6), ("mm", 1e-3), ("m", 1.0)):
        if text.endswith(unit):
            try:
                value = parse_number(text.removesuffix(unit)) * scale
            except ValueError:
                break
            if 0 < value < float("inf"):
                return value
            break
    raise ArgumentTypeError(f"expected a length above 0 with its unit, 20um, 0.02mm or 2e-5m, not {text!r}")


def parse_numbers(texts: list[str], count: int, option: str) -> list[float]:
    """So many numbers of an option's words, apart by commas or spaces. Raises RigError for anything else"""
    try:
        found = [parse_number(word) for word in re.split(r"[,\s]+", " ".join(texts).strip(", "))]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(value) < 1e6 for value in found):
        raise RigError(f"{option} takes {count} numbers, apart by commas or spaces, not {' '.join(texts)!r}")
    return found


def add_driving(parser: ArgumentParser) -> None:
    """Arguments of every command that talks to the controller."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    add_port(parser)


def add_port(parser: ArgumentParser) -> None:
    """Where the controller is, and a trace of what is said."""
    parser.add_argument(
        "--port", help="where the controller is, instead of what [controller] says: a device, socket://.., rfc2217://.."
    )
    parser.add_argument("--trace", metavar="FILE", type=Path, help="write every byte there, with its time")


def print_comparison(held: HeldOut, title: str) -> None:
    """Print a HeldOut as a table in mm and mrad."""
    from calib.certify.calibration_verdict import ratio_text

    names = ("mean", "RMS", "95 %", "max")
    print(f"{title}, N = {held.after.n}, {held.configurations} distinct configurations:")
    print(f"{'':14}{'position, mm':>40}{'rotation, mrad':>43}")
    print(f"{'':14}" + "".join(f"{name:>10}" for name in names) + "   " + "".join(f"{name:>10}" for name in names))
    for name, figures in (("owner's model", held.before), ("corrected", held.after)):
        position, rotation = (figures.mean[0], *figures.position), (figures.mean[1], *figures.rotation)
        print(f"{name:14}" + "".join(map(_cell, position)) + "   " + "".join(map(_cell, rotation)))
    turned = "; rotations were not measured"
    if held.floor[1] < 1:
        turned = f" and {held.floor[1] * 1e3:.4f} mrad" if held.floor[1] else "; it does not turn"
    placed = f"{held.floor[0] * 1e3:.4f} mm" if held.floor[0] < 1 else ""
    words = f"{placed}{turned}" if placed else f"{turned.removeprefix(' and ')}; positions were not measured"
    print(f"on these poses {ratio_text(held.ratio)}; the measured poses themselves are uncertain by {words}")


def _cell(value: float) -> str:
    return f"{value * 1e3:10.4f}" if value == value else f"{'-':>10}"


def require_drawing(what: str) -> None:
    """Raise MissingLibrary where that which draws PDF and pictures is not installed. what : is to be drawn, in the
    plural
    """
    problem = missing_drawing_reason()
    if problem:
        raise MissingLibrary(f"{what} {problem}")


def missing_drawing_reason() -> str | None:
    """Why no PDF and pictures can be drawn, in words that follow theirs; None where they can."""
    from importlib.util import find_spec

    return None if find_spec("matplotlib") else "are drawn by matplotlib: pip install 'rig[print]'"


def print_unsolved(measured: Measurement | None) -> None:
    """Print the frames of a Measurement that have no pose, with their reasons."""
    if measured is None or not measured.unsolved:
        return
    print(f"{len(measured.unsolved)} frames without a pose:")
    for frame, reason in sorted(measured.unsolved.items())[:20]:
        print(f"  frame {frame}: {reason}")
    if len(measured.unsolved) > 20:
        print(f"  and {len(measured.unsolved) - 20} more")
