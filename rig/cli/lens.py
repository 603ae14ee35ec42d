"""rig lens: calibrate one camera's lens.

From photographs of a board; models are compared, and the [[camera]] block is printed.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.array_and_json_types import Json
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    page_links,
)
from rig.errors import RigError

if TYPE_CHECKING:
    from vision.lenses.lens_calibration_from_photographs import Calibrated

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp")


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig lens` to a parser."""
    parser.add_argument(
        "images", metavar="IMAGES", type=Path, nargs="+", help="photographs of the board, or a folder of them"
    )
    parser.add_argument(
        "--board",
        required=True,
        help="charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY (squares), as "
        "charuco:5x7:36mm:18mm:DICT_6X6_250, or aruco:COLUMNSxROWS:SIDE:GAP:DICTIONARY (markers); "
        "plain numbers are in m; aprilgrid: "
        "the same, numbered from the lower left",
    )
    parser.add_argument(
        "--legacy",
        action="store_true",
        help="the charuco's first square holds a marker (boards of OpenCV before 4.6, even rows)",
    )
    parser.add_argument("--name", default="cam0", help="the camera's name in the block (%(default)s)")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="gets lens.html with residual map and uncertainty, and camera.toml"
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig lens`.

    Calibrate a camera's lens from photographs and print its [[camera]] block.
    """
    import sys
    from dataclasses import replace

    from rig.model.calibration_board_layout_and_description_parsing import parse_board

    try:
        board = replace(parse_board(arguments.board), legacy=arguments.legacy)
    except RigError as error:
        raise RigError(f"--board: {error}") from None
    paths = _paths(arguments.images)
    if not arguments.name or not arguments.name.isprintable() or '"' in arguments.name or "\\" in arguments.name:
        raise RigError(f"--name {arguments.name!r} is not a valid camera name")
    out = arguments.outputs.folder(arguments.out) if arguments.out else None

    from calib.report.platform_and_lens_calibration_pages import lens_verdict, write_lens_page
    from rig.formats.output_files import write_text
    from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import camera_toml
    from vision.lenses.lens_calibration_from_photographs import calibrate_photographs

    found = calibrate_photographs(paths, board, arguments.name, Progress())
    block = camera_toml(found.fit.camera)
    for path, reason in found.left_out:
        print(f"left out: {path}: {reason}", file=sys.stderr)
    print(
        f"{len(found.used)} of {len(paths)} photographs, {found.fit.inliers.sum()} of "
        f"{len(found.fit.inliers)} corners of the board",
        file=sys.stderr,
    )
    print(
        f"{'lens model':>22} {'fitted':>9} {'held out':>9}   RMS px per axis, every photograph in turn "
        "predicted from the others",
        file=sys.stderr,
    )
    for terms, line in found.models.items():
        held = f"{line.rms:9.4f} {line.held.rms:9.4f}" if line.held else f"{line.reason}"
        print(f"{_model(terms):>22} {held}{'   <- chosen' if terms == found.fit.terms else ''}", file=sys.stderr)
    print(
        f"projection known to {found.middle:.3f} px in the middle of the frame, {found.worst:.3f} px at "
        "worst (standard uncertainty)",
        file=sys.stderr,
    )
    if not arguments.json:
        print(block, end="")
    arguments.result = _result(found) | {"verdict": lens_verdict(found).tree()}
    if out:
        write_text(out / "camera.toml", block)
        write_lens_page(out / "lens.html", found, page_links(arguments, arguments.out / "lens.html"))
        print(f"written: {arguments.out}/camera.toml; look at {arguments.out}/lens.html", file=sys.stderr)


def _result(found: "Calibrated") -> Json:
    """What --json prints."""
    camera = found.fit.camera
    models = [
        {
            "distortion_terms": terms,
            "rms_px": line.rms,
            "held_out_px": line.held.rms if line.held else None,
            "taken": terms == found.fit.terms,
        }
        for terms, line in found.models.items()
    ]
    return {
        "schema": "lens/1",
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        "photographs": len(found.used),
        "left_out": {str(path): why for path, why in found.left_out},
        "projection_px": {"middle": float(found.middle), "worst": float(found.worst)},
        "models": models,
    }


def _model(terms: int) -> str:
    return f"{terms} distortion terms" if terms else "no distortion"


def _paths(given: list[Path]) -> list[Path]:
    """Photographs named, or lying in a folder named. Raises RigError for what is not there and for a folder without
    any.
    """
    paths = []
    for path in given:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES)
            if not inside:
                raise RigError(f"{path}: no photographs in this folder ({', '.join(SUFFIXES)})")
            paths += inside
        elif path.exists():
            paths.append(path)
        else:
            raise RigError(f"{path}: no such file or folder")
    return paths
