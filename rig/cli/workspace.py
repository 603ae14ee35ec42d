"""rig workspace: effect of a calibration on the workspace: poses lost and gained, limits, singularities."""

from __future__ import annotations

import hashlib
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import add_json_result_option, add_overwrite_option, page_links
from rig.errors import FileError, RigError

if TYPE_CHECKING:
    from calib.workspace.workspace_cells import Workspace
    from rig.arrays import Floats


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "--certificate",
        metavar="FILE",
        type=Path,
        help="certificate.json of this calibration: what it promises stands beside the "
        "bound in the cells of its volume",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="a folder for workspace.json, workspace.csv (a line a cell) and workspace.html",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Say what a calibration does to the workspace, and write its map."""
    from calib.files import calibration_file
    from calib.models.corrected_pose_covariance import calibration_with_workspace
    from calib.workspace import workspace_page
    from calib.workspace.workspace_cells import axis_margin_description, workspace_dict
    from calib.workspace.workspace_page import workspace_verdict
    from rig.model import mechanisms

    if arguments.out is not None and arguments.out.suffix:
        raise RigError(f"{arguments.out}: --out takes a folder, for three files")
    calibration = calibration_file.load(arguments.calibration)
    if calibration.correction.nominal.bodies:
        raise RigError(
            f"{arguments.calibration} is of a chain, which comes to most poses in many ways: it has no map "
            "of its workspace"
        )
    if calibration.workspace is None:
        print(f"{arguments.calibration} was made before a calibration held its workspace: worked out now")
        calibration = calibration_with_workspace(calibration)
    w, correction = calibration.workspace, calibration.correction
    assert w is not None
    certified = None if arguments.certificate is None else _certified(arguments.certificate, arguments.calibration, w)
    unit = mechanisms.travel_unit(correction.nominal)
    verdict = workspace_verdict(w, workspace_page.workspace_lines(w, unit)[0].removeprefix("workspace: "))
    print("\n".join([verdict.line, *workspace_page.workspace_lines(w, unit)]))
    if certified is not None:
        print(workspace_page.certified_cells_line(certified))
    if correction.extension is not None or any(correction.remainder):
        print(
            "beyond the recorded configurations what is corrected on top of the geometry is extrapolated; "
            "its bound grows there"
        )
    arguments.result = {"verdict": verdict.tree(), **workspace_dict(w), "room_of": axis_margin_description(correction)}
    if arguments.out is not None:
        _write(arguments, w, unit, axis_margin_description(correction), certified)


def _write(arguments: Namespace, w: Workspace, unit: str, room_of: str, certified: Floats | None) -> None:
    """Write the map as data, as a table and as a page."""
    import json

    from calib.workspace.workspace_cells import COLUMNS, workspace_rows
    from calib.workspace.workspace_page import write_workspace_page
    from rig.formats.output_files import write_text
    from rig.recording.recording_tables import write_table

    folder = arguments.outputs.folder(arguments.out)
    write_text(folder / "workspace.json", json.dumps(arguments.result, allow_nan=False) + "\n")
    write_table(folder / "workspace.csv", COLUMNS, workspace_rows(w))
    write_workspace_page(
        folder / "workspace.html",
        arguments.calibration.name,
        w,
        unit,
        room_of,
        certified,
        page_links(arguments, arguments.out / "workspace.html"),
    )
    print(f"written: {arguments.out}; look at {arguments.out / 'workspace.html'}")


def _certified(path: Path, calibration: Path, w: Workspace) -> Floats:
    """(c, 2) m and rad that a certificate promises in the cells of a Workspace; NaN where it does not speak of them.

    Raises FileError for a file that is no certificate, or one of another calibration
    """
    from calib.workspace.workspace_cells import certified_cell_promises
    from rig.formats import structured_files

    tree = structured_files.load_json(path, "certificate", "certificate/1")
    marks = tree.table("inputs_sha256")
    mine = hashlib.sha256(calibration.read_bytes()).hexdigest()
    if mine not in {marks.table(name).text("file", default=None) for name in marks.tree}:
        raise FileError(path, f"certifies another calibration than {calibration}: its hash is not among inputs_sha256")
    return certified_cell_promises(w, tree)
