"""rig view: view a recording.

rig view index: write an index page of pages.
A picture of one frame with markers and residuals, or a 3-D page of all poses. The index is of all pages below a folder,
each with its verdict.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.input_file_options_and_loading import add_recording_argument, read_recording
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_overwrite_option,
    file_or_stdout,
    page_links,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number, parse_whole_number


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig view` to a parser."""
    add_recording_argument(parser)
    shown = parser.add_mutually_exclusive_group(required=True)
    shown.add_argument("--frame", type=parse_whole_number, help="draw the detections of this frame")
    shown.add_argument(
        "--page",
        metavar="FILE",
        type=Path,
        help="a page with the rig in three dimensions, its poses played; needs no network",
    )
    shown.add_argument(
        "--rerun", metavar="FILE.rrd", type=Path, help="all frames, for the viewer Rerun (`rerun FILE.rrd`)"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        help="for --frame, a picture, written here; without it one named after the "
        "recording is written in the current folder, and shown",
    )
    add_overwrite_option(parser)
    parser.add_argument(
        "--enlarge",
        type=parse_number,
        default=200.0,
        help="for --frame, enlargement of the drawn residuals (default 200)",
    )
    parser.add_argument(
        "--effect",
        metavar="EFFECT",
        action="append",
        default=[],
        help="for --page, what this effect would do to the poses, at "
        "several sizes; as for rig simulate; may be repeated",
    )


def run(arguments: Namespace) -> None:
    """Run `rig view`.

    Draw one frame of a recording, or all its poses in 3-D.
    """
    from calib.api.recording_check_combination_and_view import ViewOptions, view

    _refuse_options_of_other_views(arguments)
    options = ViewOptions(arguments.frame, arguments.rerun is not None, arguments.enlarge, tuple(arguments.effect))
    recording = read_recording(arguments)
    shown = _shown_file(arguments, recording.folder)
    out = arguments.outputs.file(shown)
    links = page_links(arguments, shown) if arguments.page is not None else ()
    lines = view(recording, out, options, links, Progress())
    if arguments.rerun is not None:
        lines = (*lines[:-1], f"{lines[-1]}; written: {shown}; see them with `rerun {shown}`")
    for line in lines:
        print(line)
    arguments.outputs.finish()
    if arguments.rerun is None:
        print(f"written: {shown}")
    if arguments.frame is not None and arguments.out is None:
        _open(shown)


def _refuse_options_of_other_views(arguments: Namespace) -> None:
    """Raise RigError for --out and --effect with a view that does not take them."""
    if arguments.frame is None and arguments.out is not None:
        raise RigError(
            f"--out is for --frame; --{'page' if arguments.page is not None else 'rerun'} names its own file"
        )
    if arguments.page is None and arguments.effect:
        raise RigError("--effect is for --page")


def _shown_file(arguments: Namespace, folder: Path) -> Path:
    """The file that shows a recording's folder. Raises FileError for a picture's unknown format."""
    from vision.measured_frame_drawings_and_frame_jpegs import picture_file_suffix

    named: Path | None = arguments.page or arguments.rerun
    if named is None:
        named = arguments.out or Path(f"{folder.resolve().name}-frame-{arguments.frame}.png")
        picture_file_suffix(named)
    return named


def _open(picture: Path) -> None:
    import webbrowser

    if not webbrowser.open(picture.resolve().as_uri()):
        print("there is no program here to display it; open the file manually")


def arguments_of_index(parser: ArgumentParser) -> None:
    """Add the arguments of `rig view index` to a parser."""
    parser.add_argument(
        "folder",
        metavar="DIR",
        type=Path,
        nargs="?",
        default=Path("."),
        help="gets index.html; this one by default. Commands that write a page below it keep it up to date",
    )
    add_overwrite_option(parser)


def run_index(arguments: Namespace) -> None:
    """Run `rig view index`.

    Write the index page of all pages below a folder. Raises RigError where there is no such folder.
    """
    from rig.report.pages.page_templates_and_index_page import NAME, list_pages_below_folder, write_index_page

    if not arguments.folder.is_dir():
        raise RigError(f"{arguments.folder}: no such folder")
    write_index_page(arguments.outputs.file(arguments.folder / NAME), arguments.folder)
    known = list_pages_below_folder(arguments.folder)
    for found in known:
        print(f"{found.state:6} {found.path}: {found.why}")
    print(f"written: {arguments.folder / NAME}" + ("" if known else "; there is no page yet"))
