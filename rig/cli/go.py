"""rig go: move the platform to one pose through a calibration: corrected lengths, checked, read back."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files
from rig.cli.shared.command_options import add_json_result_option, add_port_options
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_numbers

if TYPE_CHECKING:
    from argparse import Namespace

    from scipy.spatial.transform import RigidTransform

    from calib.certification.calibration import Calibration
    from rig.arrays import Floats
    from rig.model.mechanism_geometry import Hexapod


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "--rig",
        metavar="RIG.toml",
        type=Path,
        default=Path("rig.toml"),
        help="with the [controller] to drive (default: rig.toml here)",
    )
    parser.add_argument(
        "--pose", metavar="X,Y,Z,RX,RY,RZ", required=True, help="platform in base: m, and a rotation vector in rad"
    )
    parser.add_argument(
        "--uncorrected", action="store_true", help="command what the owner's model says, for comparison"
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be commanded, and move nothing")
    parser.add_argument(
        "--speed", type=parse_number, default=1.0, metavar="SHARE", help="of the struts' greatest speed (default 1)"
    )
    parser.add_argument(
        "--trust", action="store_true", help="believe the position that the controller reads, though it was not homed"
    )
    calibration_and_effect_files.add_effects_option(parser)
    add_port_options(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Go to a pose: the corrected lengths, checked, commanded and read back."""
    import numpy as np

    from calib.correction.correction import require_reachable
    from rig.cli.shared.controller_session import design_with_controller, lengths_text, open_driver, print_status
    from rig.model import mechanisms
    from rig.model.mechanism_kinds import require_hexapod
    from rig.model.pose import pose_to_vector

    if not 0 < arguments.speed <= 1:
        raise RigError(f"--speed takes a share above 0 and up to 1, got {arguments.speed:g}")
    design = design_with_controller(arguments.rig, arguments.port)
    calibration = calibration_and_effect_files.load_calibration(
        arguments.calibration, calibration_and_effect_files.load_effect_files(arguments)
    )
    calibration_and_effect_files.read_refutations(arguments.calibration)
    correction = calibration.correction
    _same(correction.nominal, require_hexapod(design.mechanism), arguments)
    wanted = parse_pose(arguments.pose)
    home = mechanisms.kinematics_of(correction.nominal).home(correction.nominal)
    lengths = correction.uncorrected(wanted) if arguments.uncorrected else _lengths(calibration, wanted, home)
    require_reachable(np.array([lengths]), require_hexapod(design.mechanism), ["the pose"])
    print(
        f"to command: {lengths_text(lengths)}, which is "
        f"{lengths_text(lengths - correction.uncorrected(wanted))} off the owner's model"
    )
    arguments.result = {
        "schema": "gone/1",
        "commanded": lengths.tolist(),
        "off_owners_model": (lengths - correction.uncorrected(wanted)).tolist(),
        "moved": False,
    }
    if arguments.dry_run:
        return
    with open_driver(design, arguments.trace, print) as driver:
        if arguments.trust:
            driver.trust()
        if calibration.physics is not None and not arguments.uncorrected:  # from where it stands, not from home
            lengths = _lengths(calibration, wanted, driver.status().lengths)
            require_reachable(np.array([lengths]), require_hexapod(design.mechanism), ["the pose"])
        driver.move(lengths, arguments.speed)
        status = driver.status()
        print_status(status, design)
    arguments.result |= {
        "commanded": lengths.tolist(),
        "off_owners_model": (lengths - correction.uncorrected(wanted)).tolist(),
        "moved": True,
        "lengths": status.lengths.tolist(),
    }
    left = wanted.inv() * correction.predict(correction.inverse_without_physics(wanted) + status.lengths - lengths)
    if not arguments.uncorrected:
        arguments.result |= {"left": pose_to_vector(left).tolist()}
        print(
            f"by the calibration the platform is within {np.linalg.norm(left.translation) * 1e6:.1f} um and "
            f"{left.rotation.magnitude() * 1e6:.1f} urad of the pose"
        )


def _lengths(calibration: Calibration, wanted: RigidTransform, start: Floats) -> Floats:
    """(axes,) m or rad that give a wanted pose (), the axes coming from start (axes,); what nobody logs is taken as
    when calibrated.
    """
    import numpy as np
    from scipy.spatial.transform import RigidTransform

    from calib.models.wanted_pose_commands import commands_along_route

    return commands_along_route(
        calibration, RigidTransform.from_matrix(wanted.as_matrix()[None]), np.asarray(start, float)
    ).values[0]


def parse_pose(text: str) -> RigidTransform:
    """Parse a pose, six numbers joined by commas, m and rad, as RigidTransform. Raises RigError for anything else."""
    import numpy as np

    from rig.formats.checked_entries import LARGEST_RIG
    from rig.model.pose import pose

    try:
        values = np.array(parse_numbers(text.split(",")))
    except ValueError:
        values = np.zeros(0)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise RigError(f"--pose takes six figures joined by commas, x,y,z (m) and rx,ry,rz (rad), got {text!r}")
    if np.abs(values[:3]).max() > LARGEST_RIG:
        raise RigError(
            f"--pose {text}: {np.abs(values[:3]).max():g} m is implausible: poses are in metres and radians "
            "(millimetres?)"
        )
    return pose(values[:3], values[3:])


def _same(nominal: Hexapod, mechanism: Hexapod, arguments: Namespace) -> None:
    """Raise RigError where a calibration is of another rig than the one to drive."""
    import numpy as np

    names = [name for name in mechanism.geometry_arrays if name != "strut_zeros"]
    if nominal.kind != mechanism.kind or not all(
        np.allclose(getattr(nominal, name), getattr(mechanism, name), rtol=0, atol=1e-6) for name in names
    ):
        raise RigError(
            f"{arguments.calibration} is a calibration of another rig than {arguments.rig}: their stated joints differ"
        )
