"""rig status RIG.toml."""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.output_options import add_driving, add_result


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_driving(parser)
    add_result(parser)


def run(arguments: Namespace) -> None:
    """Say what the controller says; nothing moves."""
    from rig.cli.shared.controller_session import design_with_controller, open_driver, print_status

    design = design_with_controller(arguments.design, arguments.port)
    with open_driver(design, arguments.trace, print) as driver:
        status = driver.status()
    print_status(status, design)
    arguments.result = {
        "schema": "status/1",
        "activity": status.activity,
        "known": status.known,
        "fault": status.fault,
        "said": status.said,
        "lengths": status.lengths.tolist(),
    }
