"""rig home, jog, stop and status: single commands to a controller.

Struts are homed, or moved once, by a distance or to given lengths and checked as any move; nothing is interactive. A
stop was begun before this is imported (rig.cli.urgent_stop_before_slow_imports). For status, nothing moves.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    require_speed_share_within_zero_to_one,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_rig_toml_port_and_trace_arguments,
    add_speed_option,
    add_trust_option,
)
from rig.errors import PositionLost, RigError
from rig.formats.numbers_and_units import parse_whole_number

if TYPE_CHECKING:
    from rig.driving.controller_address_and_urgent_stop import UrgentStop


def arguments_of_home(parser: ArgumentParser) -> None:
    """Add the arguments of `rig home` to a parser."""
    add_rig_toml_port_and_trace_arguments(parser)
    parser.add_argument("--unlock", action="store_true", help="clear the controller's alarm first")


def run_home(arguments: Namespace) -> None:
    """Run `rig home`.

    Home all struts and print their positions.
    """
    from rig.cli.shared.terminal_run_display_and_printed_controller_status import print_controller_status
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

    design = design_with_controller_port(arguments.design, arguments.port)
    with open_driver(design, arguments.trace, print) as driver:
        if arguments.unlock and not driver.status().homing_required:  # which homing alone ends
            driver.unlock()
        print_controller_status(driver.home(), design)


def arguments_of_jog(parser: ArgumentParser) -> None:
    """Add the arguments of `rig jog` to a parser."""
    add_rig_toml_port_and_trace_arguments(parser)
    parser.add_argument(
        "--strut",
        type=parse_whole_number,
        action="append",
        metavar="N",
        help="strut, joint or slide, 1.. (may be repeated; by default all of them)",
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--by",
        metavar="3mm",
        help="longer, of joints further, by this amount (plain numbers are in mm, of joints in deg)",
    )
    where.add_argument(
        "--to",
        metavar="300mm,..",
        help="to these lengths or angles, one for every axis (plain numbers are in mm, of joints in deg)",
    )
    add_speed_option(parser, 0.25)
    parser.add_argument(
        "--unlock",
        action="store_true",
        help="clear the controller's alarm first; its position is then trusted with --trust only",
    )
    add_trust_option(parser)


def run_jog(arguments: Namespace) -> None:
    """Run `rig jog`.

    Jog struts, checked as any move. Raises RigError for other struts and lengths, PositionLost before homing.
    """
    import numpy as np

    from rig.cli.shared.terminal_run_display_and_printed_controller_status import print_controller_status
    from rig.driving.axis_display_units_and_controller_counts import MM_AND_DEGREES, axes_word, parse_axis_values
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver
    from rig.driving.move_profiles_and_path_check import jog_goal
    from rig.model.mechanisms import axis_units

    design = design_with_controller_port(arguments.design, arguments.port)
    count = len(design.mechanism.axes)
    struts = arguments.strut or list(range(1, count + 1))
    if not all(1 <= strut <= count for strut in struts):
        raise RigError(f"--strut takes 1 .. {count}, got {', '.join(map(str, struts))}")
    require_speed_share_within_zero_to_one(arguments.speed)
    if arguments.to and arguments.strut:
        raise RigError("--to states the value of every axis; omit --strut")
    units, moves = axis_units(design.mechanism), np.isin(np.arange(1, count + 1), struts)
    if arguments.by and len({units[strut - 1] for strut in struts}) > 1:
        raise RigError("--by is one length or one angle, and these axes count both: name some by --strut")
    texts = arguments.to.split(",") if arguments.to else [arguments.by if one else "0" for one in moves]
    goal = parse_axis_values("--to" if arguments.to else "--by", texts, units, MM_AND_DEGREES)
    with open_driver(design, arguments.trace, print) as driver:
        if arguments.unlock:
            driver.unlock()
        if arguments.trust:
            driver.trust()
        if not driver.status().known:
            raise PositionLost(
                f"the position of the {axes_word(design.mechanism)} is not known, and so not their remaining travel; "
                "home them, or use --trust"
            )
        if arguments.by:
            goal = jog_goal(driver.lengths() + goal, moves & bool(arguments.strut), driver.mechanism)
        driver.move(goal, arguments.speed)
        print_controller_status(driver.status(), design)


PATIENCE = 10.0  # s for a process that drives to let go


def arguments_of_stop(parser: ArgumentParser) -> None:
    """Add the arguments of `rig stop` to a parser."""
    add_rig_toml_port_and_trace_arguments(parser)


def run_stop(arguments: Namespace) -> None:
    """Run `rig stop`.

    Stop the struts, and any process that moves them; its run can be resumed.
    """
    begun = arguments.urgent_stop or _urgent_stop(arguments)
    if isinstance(begun, BaseException):
        raise begun
    with begun:
        if begun.holder is not None:
            begun.await_holder(PATIENCE)
            print(f"process {begun.holder.pid}, which drove them, was stopped")
        stopped = begun.stopped_controller()

        from rig.cli.shared.terminal_run_display_and_printed_controller_status import print_controller_status
        from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

        design = design_with_controller_port(arguments.design, arguments.port)
        with open_driver(design, arguments.trace, print, begun.clock, stopped) as driver:
            print_controller_status(driver.status(), design)


def _urgent_stop(arguments: Namespace) -> UrgentStop:
    """A stop that is begun now, of a rig.toml that has to be read whole for it."""
    from rig.driving.controller_address_and_urgent_stop import UrgentStop, controller_address_in_rig_toml
    from rig.driving.driver_opening_and_settling import address_of_controller, design_with_controller_port
    from rig.driving.driving_clock import SystemClock

    address = controller_address_in_rig_toml(arguments.design, arguments.port)
    if address is None:
        stated = design_with_controller_port(arguments.design, arguments.port)
        address = address_of_controller(stated.driver(), stated.mechanism)
    return UrgentStop(address, SystemClock())


def arguments_of_status(parser: ArgumentParser) -> None:
    """Add the arguments of `rig status` to a parser."""
    add_rig_toml_port_and_trace_arguments(parser)
    add_json_result_option(parser)


def run_status(arguments: Namespace) -> None:
    """Run `rig status`.

    Print the status of the controller.

    Nothing moves.
    """
    from rig.cli.shared.terminal_run_display_and_printed_controller_status import print_controller_status
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

    design = design_with_controller_port(arguments.design, arguments.port)
    with open_driver(design, arguments.trace, print) as driver:
        status, warnings = driver.status(), driver.limit_warnings()
    print_controller_status(status, design)
    for line in warnings:
        print(f"warning: {line}")
    arguments.result = {
        "schema": "status/1",
        "activity": status.activity,
        "known": status.known,
        "fault": status.fault,
        "said": status.controller_text,
        "lengths": status.lengths.tolist(),
        "warnings": warnings,
    }
