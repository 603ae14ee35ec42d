"""rig view REC --frame N."""

from pathlib import Path

from rig.commands.output import Progress, fresh_file


def arguments(parser):
    """Add this command's arguments to a parser."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument("--frame", type=int, required=True)
    parser.add_argument("--out", metavar="FILE", type=Path, help="a PNG, written here; without it the picture is shown")
    parser.add_argument("--enlarge", type=float, default=200.0, help="how much longer than they are residuals are drawn (default 200)")


def run(arguments):
    """Draw one frame."""
    import tempfile
    import webbrowser

    from rig import recording as recordings

    recording = recordings.load(arguments.recording)
    out = fresh_file(arguments.out, recording.folder) if arguments.out else Path(tempfile.gettempdir()) / f"rig-frame-{arguments.frame}.png"

    from vision.drawing import frame_picture, save

    text = save(out, *frame_picture(recording, arguments.frame, arguments.enlarge, Progress()))
    print(text)
    print(f"written: {out}")
    if arguments.out is None and not webbrowser.open(out.resolve().as_uri()):
        print("there is no program here to show it; open the file yourself")
