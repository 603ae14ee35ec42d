"""rig status RIG.toml."""

from rig.commands.driving import add_driving, design_of, driving, print_status


def arguments(parser):
    """Add this command's arguments to a parser."""
    add_driving(parser)


def run(arguments):
    """Say what the controller says; nothing moves."""
    design = design_of(arguments.design, arguments.port)
    with driving(design, arguments.trace, print) as driver:
        print_status(driver.status(), design)
