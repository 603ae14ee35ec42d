"""The history of a watch <-> watch.json: the reference, each visit's equations, and marks of the data."""

import json
from hashlib import sha256
from pathlib import Path

import numpy as np

from calib.drift.first_visit_reference import Reference
from calib.drift.machine_changes import OWN
from calib.drift.visit_equations import GEOMETRY, Equations
from calib.drift.visit_history import History, Visit
from rig.errors import FileError
from rig.formats import json_file
from rig.formats.checked_entries import Entries
from rig.formats.output_files import write_text
from rig.model.design import DISTORTION_TERMS, Camera
from rig.model.pose import pose_entry_text

SCHEMA = "watch/1"
MOST_PLACES = 200


def calibration_digest(calibration: Path) -> str:
    """SHA-256 of a calibration's file, by which a history knows it again."""
    return sha256(calibration.read_bytes()).hexdigest()


def write_history(path: Path | str, history: History) -> None:
    """Write a History that has visits, whole or not at all. Raises ValueError for one without."""
    r = history.reference
    if r is None:
        raise ValueError("expected a history with visits, got one without")
    cameras = [
        {
            "name": c.name,
            "width": c.width,
            "height": c.height,
            "matrix": c.matrix.tolist(),
            "distortion": c.distortion.tolist(),
            "pose": pose_entry_text(c.pose),
            "shutter": c.shutter,
            "row_time": c.row_time,
        }
        for c in r.cameras
    ]
    visits = [
        {
            "name": v.name,
            "visits": v.visits,
            "quiet": v.quiet,
            "square": v.square,
            "count": v.count,
            "log_sum": v.log_sum,
            "information": v.equations.information[np.triu_indices(len(v.equations.right))].tolist(),
            "right": v.equations.right.tolist(),
            "own_square": v.equations.square,
        }
        for v in history.visits
    ]
    tree = {
        "schema": SCHEMA,
        "calibration_sha256": history.calibration,
        "places": r.places,
        "base": r.base,
        "targets": r.targets,
        "cameras": cameras,
        "visits": visits,
        "data": sorted(history.data),
    }
    write_text(path, json.dumps(tree) + "\n")


def read_history(path: Path | str, calibration: str) -> History:
    """History as `write_history` wrote it. calibration : SHA-256 of the file that it must be about.

    Raises FileError for a file that is missing, cut off, none of these, or of another calibration
    """
    tree = json_file.load(Path(path), "history of a watch", SCHEMA)
    if tree.text("calibration_sha256") != calibration:
        raise FileError(path, "is the history of another calibration; name another file, and a new history begins")
    places = tree.texts("places")
    if not 0 < len(places) <= MOST_PLACES:
        tree.fail(f"places has {len(places)} names; a rig has 1 to {MOST_PLACES}", "places")
    unknowns = 6 * len(places) + GEOMETRY + len(OWN)
    reference = Reference(
        tuple(_camera(table) for table in tree.tables("cameras")), places, tree.texts("base"), tree.text("targets")
    )
    return History(
        calibration,
        reference,
        tuple(_visit(table, unknowns) for table in tree.tables("visits")),
        frozenset(tree.texts("data")),
    )


def _camera(table: Entries) -> Camera:
    distortion = table.array("distortion", (None,))
    if len(distortion) not in DISTORTION_TERMS:
        table.fail(
            f"{table.name('distortion')} has {len(distortion)} terms, not {', '.join(map(str, DISTORTION_TERMS))}",
            "distortion",
        )
    return Camera(
        table.identifier("name"),
        table.whole("width", 1),
        table.whole("height", 1),
        table.array("matrix", (3, 3)),
        distortion,
        table.pose("pose"),
        table.text("shutter", ("global", "rolling")),
        table.number("row_time"),
    )


def _visit(table: Entries, unknowns: int) -> Visit:
    upper = np.triu_indices(unknowns)
    values = table.array("information", (len(upper[0]),))
    information = np.zeros((unknowns, unknowns))
    information[upper] = values
    information.T[upper] = values
    least, *_, most = np.linalg.eigvalsh(information)
    if least < -1e-6 * abs(most):
        table.fail(f"{table.name('information')} is no information", "information")
    equations = Equations(
        information, table.array("right", (unknowns,)), table.number("own_square"), table.whole("count", 1)
    )
    return Visit(
        table.text("name"),
        equations,
        table.number("square"),
        equations.count,
        table.number("log_sum"),
        table.whole("visits", 1),
        table.flag("quiet"),
    )
