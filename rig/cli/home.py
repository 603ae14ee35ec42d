"""rig home: homing of all struts.

By the controller, and their positions are printed.
"""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.common_options import add_controller_arguments


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig home` to a parser."""
    add_controller_arguments(parser)
    parser.add_argument("--unlock", action="store_true", help="clear the controller's alarm first")


def run(arguments: Namespace) -> None:
    """Run `rig home`.

    Home all struts and print their positions.
    """
    from rig.cli.shared.run_display_and_controller_status import print_status
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

    design = design_with_controller_port(arguments.design, arguments.port)
    with open_driver(design, arguments.trace, print) as driver:
        if arguments.unlock:
            driver.unlock()
        print_status(driver.home(), design)
