"""rig print RIG.toml --out sheets.pdf."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.commands.output import add_force, file_or_stdout


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, required=True, help="a PDF, a sheet for each cube")
    parser.add_argument("--paper", default="A4", help="A4, A3, A2, A1 or A0; a net that is too large takes the next size")
    add_force(parser)


def run(arguments: Namespace) -> None:
    """Write the sheets."""
    from rig import design_file

    design = design_file.load(arguments.design)
    out = arguments.outputs.file(arguments.out)

    from synthetic.sheets import sheets

    for line in sheets(design, out, arguments.paper):
        print(line)
    print(f"written: {arguments.out}. Print at 100 %, without fitting to the page, and hold a ruler to the ruler on each sheet.")
