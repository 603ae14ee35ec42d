"""rig effects [NAME]."""

from argparse import ArgumentParser, Namespace

from rig.commands.output import add_json, print_json
from rig.errors import RigError


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("name", metavar="NAME", nargs="?", help="one of them, whole; all as a table without it")
    add_json(parser)


def run(arguments: Namespace) -> None:
    """Print the catalogue as a table, or one effect whole."""
    from shutil import get_terminal_size

    from rig.commands.usage import meant
    from rig.effects import ALL, BY_NAME
    from rig.effects.listing import table, tree, whole

    width = get_terminal_size((160, 24)).columns
    if arguments.name is None:
        if arguments.json:
            print_json([tree(effect) for effect in ALL])
        else:
            print(table(ALL, width), end="")
        return
    if arguments.name not in BY_NAME:
        raise RigError(f"there is no effect {arguments.name!r}{meant(arguments.name, BY_NAME) or '.'} `rig effects` lists them")
    effect = BY_NAME[arguments.name]
    if arguments.json:
        print_json(tree(effect))
    else:
        print(whole(effect, width), end="")
