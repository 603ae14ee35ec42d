"""What `rig plan` starts from: the geometry that a calibration states, and the configurations that were visited
already.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    import numpy as np

    from calib.models.platform.d_optimal_configurations import Avoided
    from rig.model.design import Arm, Free, Hexapod, Planar2


def calibrated_geometry(arguments: Namespace, mechanism: Hexapod) -> tuple[Hexapod, Avoided | None]:
    """(geometry, which configurations are not to be visited) by the calibration that is named; the mechanism as it is
    where none is.

    Raises RigError for a calibration of another kind of mechanism
    """
    if not arguments.calibration:
        return mechanism, None
    from functools import partial

    from calib.files import calibration_file
    from calib.workspace.reachable_poses import is_pose_lost

    correction = calibration_file.load(arguments.calibration).correction
    if correction.fitted.kind != "hexapod":
        raise RigError(
            f"{arguments.calibration} is a calibration of a mechanism of kind {correction.fitted.kind!r}, "
            "not of a hexapod"
        )
    return correction.fitted, partial(is_pose_lost, correction)


def visited_configurations(path: Path, mechanism: Hexapod | Planar2 | Arm | Free) -> np.ndarray:
    """(k, 6) m configurations visited: of a recording's frames, or of a table. Raises RigError for a recording of
    another kind of machine
    """
    from rig.formats import csv_table
    from rig.recording import recording_folder

    if path.is_dir():
        read = recording_folder.load(path)
        if read.design.mechanism.kind != "hexapod":
            raise RigError(f"{path} is a recording of a mechanism of kind {read.design.mechanism.kind!r}")
        return read.commanded()[2]
    return csv_table.read(path, ("frame", *mechanism.axes)).matrix(mechanism.axes)
