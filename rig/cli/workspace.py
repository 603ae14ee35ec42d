"""rig workspace: reachable workspace with a calibration.

Poses lost and gained, limits, singularities.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    page_links,
)
from rig.errors import RigError


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig workspace` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "--certificate",
        metavar="FILE",
        type=Path,
        help="certificate.json of this calibration: its promise is listed next to the bound in the cells of its volume",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="a folder for workspace.json, workspace.csv (one line per cell) and workspace.html",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig workspace`.

    Map the workspace of a calibration and print what it changes.
    """
    from calib.api.workspace_change_by_calibration import analyse_workspace

    out = arguments.out
    if out is not None and out.suffix:
        raise RigError(f"{out}: --out takes a folder, for three files")
    result = analyse_workspace(arguments.calibration, arguments.certificate, print)
    print("\n".join([result.verdict.line, *result.lines()]))
    arguments.result = result.tree()
    if out is not None:
        result.write(arguments.outputs.folder(out), page_links(arguments, out / "workspace.html"))
        print(f"written: {out}; look at {out / 'workspace.html'}")
