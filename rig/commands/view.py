"""rig view REC --frame N."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.commands.output import Progress, add_force, add_recording, file_or_stdout, read_recording


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recording(parser)
    parser.add_argument("--frame", type=int, required=True)
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="a picture, written here; without it one named after the recording "
                        "is written in the folder where you are, and shown")
    add_force(parser)
    parser.add_argument("--enlarge", type=float, default=200.0, help="how much longer than they are residuals are drawn (default 200)")


def run(arguments: Namespace) -> None:
    """Draw one frame."""
    import webbrowser


    recording = read_recording(arguments)

    from vision.drawing import check_format, frame_picture, save

    shown = arguments.out or Path(f"{recording.folder.resolve().name}-frame-{arguments.frame}.png")
    check_format(shown)
    out = arguments.outputs.file(shown)

    text = save(out, *frame_picture(recording, arguments.frame, arguments.enlarge, Progress()))
    print(text)
    arguments.outputs.finish()
    print(f"written: {shown}")
    if arguments.out is None and not webbrowser.open(shown.resolve().as_uri()):
        print("there is no program here to show it; open the file yourself")
