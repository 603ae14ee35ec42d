"""rig print: write marker cubes to print.

Those of a rig.toml, as sheets to print true to scale (PDF), or as STL bodies.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared.common_options import add_overwrite_option, file_or_stdout, require_matplotlib
from rig.cli.shared.option_value_parsing import parse_length


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig print` to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="a PDF: the sheets of every cube, then their assembly and their placement",
    )
    parser.add_argument(
        "--paper",
        default="A4",
        help="A4 (the default), Letter, A3, Tabloid, A2, A1 or A0; a net too large for it is split over sheets",
    )
    parser.add_argument(
        "--stl", metavar="DIR", type=Path, help="gets a solid body for each cube to glue the faces on (NAME.stl, mm)"
    )
    parser.add_argument(
        "--paper-thickness",
        metavar="0.1mm",
        type=parse_length,
        default=1e-4,
        help="by which a body is smaller on each side (0.1mm)",
    )
    add_overwrite_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig print`.

    Write the sheets of a rig's markers to print, or bodies as STL.
    """
    from rig.formats.rig_toml import design_from_rig_toml

    require_matplotlib("sheets to print")
    design = design_from_rig_toml.load_design(arguments.design)
    out = arguments.outputs.file(arguments.out)
    folder = arguments.outputs.folder(arguments.stl) if arguments.stl else None

    from synthetic.print_sheets import write_sheets

    sheets = write_sheets(design, out, arguments.paper)
    for line in sheets.lines:
        print(line)
    print(
        f"written: {arguments.out}. Print at 100 %, without fitting to the page, and hold a ruler to the "
        "rulers on each sheet."
    )
    if folder is not None:
        count = sheets.write_bodies(folder, arguments.paper_thickness)
        print(
            f"written: {count} bodies in {arguments.stl}, mm, smaller on each side by the paper's "
            f"{arguments.paper_thickness * 1e3:g} mm"
        )
