"""rig calibrate REC --extend WAY [--alone | --onto CALIBRATION [--space SPACE] [--within PART]]: how corrections are
extended over a space.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    from calib.api.correction_extension import ExtendOptions

WAYS = ("linear", "simplex", "delaunay", "axes", "radial", "polynomial", "auto")
SPACES = ("configuration", "pose", "both")


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments about --extend to a parser."""
    parser.add_argument(
        "--extend",
        choices=WAYS,
        metavar="WAY",
        help="extend the corrections at the recorded configurations over all of them: "
        f"{', '.join(WAYS[:-1])} (linear and simplex take a grid, as the plan division:2 visits one), or "
        "auto, by held-out error",
    )
    parser.add_argument(
        "--alone",
        action="store_true",
        help="of --extend: correct the owner's model itself, with no geometry fitted first",
    )
    parser.add_argument(
        "--onto",
        metavar="CALIBRATION",
        type=Path,
        help="of --extend: one more pass, on the rig that this calibration corrects: "
        "what it leaves in the recording is corrected on top; order and count are kept",
    )
    parser.add_argument(
        "--space",
        choices=SPACES,
        help="of --onto: where the pass maps what is left: over configurations (default), "
        "over poses, or over both, poses then holding what the first leaves",
    )
    parser.add_argument(
        "--within",
        metavar="PART",
        help="of --onto: the part in which the pass holds, fading beyond: bounds of axes (m or rad) "
        "and of poses (x y z in m, rx ry rz in rad from home), as l1=0.40:0.46,z=0.41: ",
    )


def extend_options(arguments: Namespace) -> ExtendOptions | None:
    """How corrections are extended, None where they are not. Raises RigError for arguments that do not go together"""
    if not arguments.extend:
        if arguments.alone or arguments.onto:
            raise RigError("--alone and --onto each say on what --extend stands; it takes one of them")
        if arguments.space or arguments.within:
            raise RigError("--space and --within are of a pass; name with --onto what it stands on")
        return None
    from calib.api.correction_extension import ExtendOptions
    from calib.files import calibration_file

    onto = None if arguments.onto is None else calibration_file.load(arguments.onto)
    return ExtendOptions(
        arguments.extend, arguments.alone, onto, str(arguments.onto), arguments.space, arguments.within
    )
