"""rig status: print the controller's status.

Nothing moves.
"""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.common_options import add_controller_arguments, add_json_result_option


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig status` to a parser."""
    add_controller_arguments(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig status`.

    Print the status of the controller.

    Nothing moves.
    """
    from rig.cli.shared.run_display_and_controller_status import print_status
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

    design = design_with_controller_port(arguments.design, arguments.port)
    with open_driver(design, arguments.trace, print) as driver:
        status, warnings = driver.status(), driver.limit_warnings()
    print_status(status, design)
    for line in warnings:
        print(f"warning: {line}")
    arguments.result = {
        "schema": "status/1",
        "activity": status.activity,
        "known": status.known,
        "fault": status.fault,
        "said": status.said,
        "lengths": status.lengths.tolist(),
        "warnings": warnings,
    }
