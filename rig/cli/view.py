"""rig view: view a recording: a picture of one frame with markers and residuals, or a 3-D page of all poses."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared.argument_parser_and_common_options import add_overwrite_option, file_or_stdout, page_links
from rig.cli.shared.input_options_and_output_display import Progress, add_recording_argument, read_recording
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
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
    """Draw one frame, or the whole recording in three dimensions."""
    if arguments.page is not None:
        if arguments.out is not None:
            raise RigError("--out is for --frame; --page names its own file")
        _page(arguments)
        return
    if arguments.effect:
        raise RigError("--effect is for --page")
    if arguments.rerun is not None:
        _rerun(arguments)
        return
    _frame(arguments)


def _frame(arguments: Namespace) -> None:
    import webbrowser

    recording = read_recording(arguments)

    from vision.frame_pictures import draw_frame, picture_file_suffix, save_pictures_side_by_side

    shown = arguments.out or Path(f"{recording.folder.resolve().name}-frame-{arguments.frame}.png")
    picture_file_suffix(shown)
    out = arguments.outputs.file(shown)

    text = save_pictures_side_by_side(out, *draw_frame(recording, arguments.frame, arguments.enlarge, Progress()))
    print(text)
    arguments.outputs.finish()
    print(f"written: {shown}")
    if arguments.out is None and not webbrowser.open(shown.resolve().as_uri()):
        print("there is no program here to display it; open the file manually")


def _page(arguments: Namespace) -> None:
    from rig.effects.texts.effect_text_and_dict import parse_effect, require_nonzero_effect

    recording, effects = (
        read_recording(arguments),
        [require_nonzero_effect(parse_effect(text)) for text in arguments.effect],
    )
    out = arguments.outputs.file(arguments.page)

    from calib.report.recording_and_plan_pages import write_recording_page

    write_recording_page(out, recording, effects, page_links(arguments, arguments.page))
    print(f"written: {arguments.page}")


def _rerun(arguments: Namespace) -> None:
    """Write the whole recording for Rerun. Raises MissingLibrary without it."""
    from rig.formats.exporters import recording_as_rerun_tum_parquet

    rr = recording_as_rerun_tum_parquet.import_rerun()
    if arguments.out is not None:
        raise RigError("--out is of --frame; --rerun names its own file")
    recording = read_recording(arguments)
    left_out = recording_as_rerun_tum_parquet.write_rerun_file(recording, arguments.outputs.file(arguments.rerun), rr)
    if left_out:
        print(f"{left_out} images are left out: Rerun shows PNG and JPEG")
    print(
        f"{len(recording.exposures.times()[0])} frames; written: {arguments.rerun}; see them with `rerun "
        f"{arguments.rerun}`"
    )
