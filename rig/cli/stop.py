"""rig stop: stop the struts, and any process that moves them, immediately.

Nothing that takes time is imported before the controller was sent its urgent stop.
"""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.common_options import add_controller_arguments

PATIENCE = 10.0  # s for a process that drives to let go


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig stop` to a parser."""
    add_controller_arguments(parser)


def run(arguments: Namespace) -> None:
    """Run `rig stop`.

    Stop the struts, and any process that moves them; its run can be resumed.
    """
    from rig.driving.clock import SystemClock
    from rig.driving.controller_address_and_urgent_stop import (
        controller_address_in_rig_toml,
        urgently_stopped_controller,
    )
    from rig.driving.controller_lock import stop_lock_holder

    clock = SystemClock()
    address = controller_address_in_rig_toml(arguments.design, arguments.port)
    if address is None:
        from rig.driving.driver_opening_and_settling import address_of_controller, design_with_controller_port

        stated = design_with_controller_port(arguments.design, arguments.port)
        address = address_of_controller(stated.driver(), stated.mechanism)
    other = stop_lock_holder(address.port, clock, PATIENCE, address.usb)
    if other is not None:
        print(f"process {other}, which drove them, was stopped")
    with urgently_stopped_controller(address, clock) as stopped:
        from rig.cli.shared.run_display_and_controller_status import print_status
        from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

        design = design_with_controller_port(arguments.design, arguments.port)
        with open_driver(design, arguments.trace, print, clock, stopped) as driver:
            print_status(driver.status(), design)
