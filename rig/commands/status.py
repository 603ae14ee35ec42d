"""rig status RIG.toml."""

from argparse import ArgumentParser, Namespace

from rig.commands.output import add_driving


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_driving(parser)


def run(arguments: Namespace) -> None:
    """Say what the controller says; nothing moves."""
    from rig.commands.driving import design_of, driving, print_status

    design = design_of(arguments.design, arguments.port)
    with driving(design, arguments.trace, print) as driver:
        print_status(driver.status(), design)
