"""rig go: move the platform to one pose.

Through a calibration: corrected lengths or joint values, checked, read back.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import escaped_output_progress_error_table_and_refutations, input_file_options_and_loading
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    require_speed_share_within_zero_to_one,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_port_and_trace_options,
    add_speed_option,
    add_trust_option,
    add_units_option,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_numbers

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from calib.api.correction_server_and_move_to_pose import PoseMove
    from rig.formats.numbers_and_units import LengthAndAngleUnits


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig go` to a parser."""
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
    add_units_option(parser, "in --pose")
    parser.add_argument(
        "--uncorrected", action="store_true", help="command what the nominal model says, for comparison"
    )
    parser.add_argument("--dry-run", action="store_true", help="print what would be commanded, and move nothing")
    add_speed_option(parser, 1.0)
    add_trust_option(parser)
    input_file_options_and_loading.add_user_effect_files_option(parser)
    add_port_and_trace_options(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig go`.

    Move the platform to one pose through a calibration.
    """
    from calib.api.correction_server_and_move_to_pose import plan_pose_move, require_same_rig
    from rig.cli.shared.terminal_run_display_and_printed_controller_status import print_controller_status
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver
    from rig.formats.numbers_and_units import SI

    require_speed_share_within_zero_to_one(arguments.speed)
    design = design_with_controller_port(arguments.rig, arguments.port)
    calibration = input_file_options_and_loading.calibration_of_arguments(arguments)
    escaped_output_progress_error_table_and_refutations.read_and_print_refutations(arguments.calibration)
    require_same_rig(design, calibration, arguments.rig, arguments.calibration)
    move = plan_pose_move(design, calibration, parse_pose(arguments.pose, arguments.units or SI), arguments.uncorrected)
    if arguments.dry_run:
        _print_plan(move, driven=False)
        arguments.result = move.tree()
        return
    with open_driver(design, arguments.trace, print) as driver:
        if arguments.trust:
            driver.trust()
        done = move.carry_out(driver, arguments.speed, _print_plan)
        assert done.status is not None
        print_controller_status(done.status, design)
    arguments.result = done.tree()
    _print_remainder(done)


def _print_plan(move: PoseMove, driven: bool = True) -> None:
    """Print the values to command. driven : whether the move starts from where the axes stand, not from home"""
    from rig.driving.axis_display_units_and_controller_counts import axes_word, axis_values_text

    m = move.design.mechanism
    if m.link_rows is not None:
        stand = f"where the {axes_word(m)} stand" if driven else "zero"
        print(f"of the postures found that give the pose, the nearest to {stand}")
    print(
        f"to command: {axis_values_text(move.lengths, m)}, which is {axis_values_text(move.off_nominal, m)} off the "
        "nominal model"
    )


def _print_remainder(move: PoseMove) -> None:
    """Print how far from the pose the platform is by the calibration, with what that is itself uncertain by."""
    from rig.driving.axis_display_units_and_controller_counts import axes_word

    left, own, within = move.remainder, move.uncertainty, move.within
    if left is not None and own is not None and within is not None:
        position, rotation = (left.translation**2).sum() ** 0.5, left.rotation.magnitude()
        print(
            f"the platform is within {within[0] * 1e6:.1f} um and {within[1] * 1e6:.1f} urad of the pose (k=2): the "
            f"{axes_word(move.design.mechanism)} read {position * 1e6:.1f} um and {rotation * 1e6:.1f} urad off it, "
            f"and the calibration itself is uncertain by {2e6 * own[0]:.1f} um and {2e6 * own[1]:.1f} urad (k=2)"
        )


def parse_pose(text: str, units: LengthAndAngleUnits) -> RigidTransform:
    """Parse a pose, six numbers split by commas, as RigidTransform.

    units : of the numbers
    Raises RigError for anything else, and for a turn by more than once round
    """
    import numpy as np

    from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, LARGEST_TURN
    from rig.model.pose import pose

    try:
        values = np.array(parse_numbers(text.split(",")))
    except ValueError:
        values = np.zeros(0)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise RigError(
            f"--pose takes six figures separated by commas, x,y,z ({units.length}) and rx,ry,rz ({units.angle}), "
            f"got {text!r}"
        )
    values = units.si(values, ("m",) * 3 + ("rad",) * 3)
    for size, limit, unit in (
        (np.abs(values[:3]).max(), LARGEST_RIG, "m"),
        (np.abs(values[3:]).max(), LARGEST_TURN, "rad"),
    ):
        if size > limit:
            raise RigError(
                f"--pose {text}: {units.shown(size, unit)} is implausible: poses are in {units}; --units mm,deg states "
                "others"
            )
    return pose(values[:3], values[3:])
