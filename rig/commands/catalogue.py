"""rig catalogue [--out FILE.md]."""

from argparse import ArgumentParser, Namespace

from rig.commands import own_effects
from rig.commands.output import add_force, file_or_stdout
from rig.files import STANDARD_OUTPUT


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, default=STANDARD_OUTPUT, help="where it is written, as Markdown; printed by "
                        "default")
    own_effects.argument(parser)
    add_force(parser)


def run(arguments: Namespace) -> None:
    """Write the catalogue of left-out physics as a document: all that `rig effects NAME` says of each."""
    from rig.effects.catalogue import page
    from rig.files import write_text

    write_text(arguments.outputs.file(arguments.out), page(own_effects.known(own_effects.plugins(arguments)).values()))
    if arguments.out != STANDARD_OUTPUT:
        print(f"written: {arguments.out}")
