"""rig status RIG.toml."""

from rig.commands.output import add_driving


def arguments(parser):
    """Add this command's arguments to a parser."""
    add_driving(parser)


def run(arguments):
    """Say what the controller says; nothing moves."""
    from rig.commands.driving import design_of, driving, print_status

    design = design_of(arguments.design, arguments.port)
    with driving(design, arguments.trace, print) as driver:
        print_status(driver.status(), design)
