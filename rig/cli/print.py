"""rig print: print the cubes of a rig, and check a printed sheet by a photograph.

Cubes of a rig.toml are written as sheets to print true to scale (PDF), or as STL bodies. `rig print check` measures a
printed sheet by a photograph: the true side of its markers.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_length
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_option,
    add_overwrite_option,
    file_or_stdout,
    print_json,
    require_matplotlib,
)

if TYPE_CHECKING:
    from rig.array_and_json_types import Floats, Json
    from rig.model.design import Design
    from vision.printed_marker_size_from_photograph import Printed


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

    from synthetic.printable_target_sheets import write_sheets

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


SHEETS = {"A4": (0.210, 0.297), "Letter": (0.2159, 0.2794), "A3": (0.297, 0.420)}  # m
CUT = 1.5e-3 / 3**0.5  # m, standard uncertainty of a sheet from a packet: ISO 216 allows 1.5 mm
MEASURED = 1e-4  # m, of a sheet that somebody measured


def arguments_of_check(parser: ArgumentParser) -> None:
    """Add the arguments of `rig print check` to a parser."""
    parser.add_argument(
        "photo", metavar="PHOTO", type=Path, help="of a printed sheet, flat, from above and not too near"
    )
    parser.add_argument("design", metavar="RIG.toml", type=Path, help="whose markers they are")
    known = parser.add_mutually_exclusive_group()
    known.add_argument(
        "--sheet",
        type=_sheet,
        default=(*SHEETS["A4"], CUT),
        metavar="A4",
        help="the whole sheet is in the photograph, on a darker "
        "ground: A4 (the default), Letter, A3, or its sides as measured, 209.8mmx296.9mm, which is more certain",
    )
    known.add_argument(
        "--ruler",
        type=_ruler,
        metavar="U,V,U,V=100mm",
        help="a ruler lies in the sheet's plane: two of its lines, px in the photograph, and the length between them",
    )
    add_json_option(parser)


def run_check(arguments: Namespace) -> None:
    """Run `rig print check`.

    Check a printed marker sheet by a photograph and print the true side of its markers.
    """
    from rig.formats.rig_toml import design_from_rig_toml
    from vision.printed_marker_size_from_photograph import measure_printed_marker_scale

    design = design_from_rig_toml.load_design(arguments.design)
    found = measure_printed_marker_scale(arguments.photo, design, arguments.sheet, arguments.ruler)
    if arguments.json:
        print_json(_tree(found, design))
    else:
        _print_scale(found, design)


def _tree(found: Printed, design: Design) -> Json:
    """What --json prints."""
    return {
        "schema": "printed/1",
        "markers": found.markers,
        "directions": list(found.directions),
        "scale": list(found.scale),
        "standard_uncertainty": list(found.uncertainty),
        "bend_px": found.bend,
        "side": {name: side * found.mean_scale for name, side in _stated_sides(design)},
    }


def _print_scale(found: Printed, design: Design) -> None:
    """Print the scale by direction, then whether rig.toml is right or what to write into it."""
    print(f"{found.markers} markers, as large as designed times:")
    for direction, scale, uncertainty in zip(found.directions, found.scale, found.uncertainty):
        print(f"  {scale:.4f} +- {2 * uncertainty:.4f} (k=2) {direction}")
    within = 2 * max(found.uncertainty)
    if len(found.scale) > 1 and abs(found.scale[0] - found.scale[1]) > within:
        print("bad: the printer scales one direction; markers are not square: reprint them without fitting to the page")
    elif abs(found.mean_scale - 1) <= within:
        print(f"good: the sides of rig.toml are right to {within * 100:.2f} %")
    else:
        print(
            "check: write into rig.toml "
            + "; ".join(
                f"marker = {side * found.mean_scale:.6f} m or {side * found.mean_scale * 1e3:.3f} mm (target {name}, "
                f"stated {side:.6f} m)"
                for name, side in _stated_sides(design)
            )
        )


def _stated_sides(design: Design) -> list[tuple[str, float]]:
    """(name, side m) of the targets, of loose markers their first."""
    return [
        (target.name, target.marker if target.marker is not None else target.listed[0].side)
        for target in design.targets
    ]


def _sheet(text: str) -> tuple[float, float, float]:
    if text in SHEETS:
        return (*SHEETS[text], CUT)
    width, cross, height = text.partition("x")
    if not cross:
        raise ArgumentTypeError(f"takes {', '.join(SHEETS)} or sides as 209.8mmx296.9mm, not {text!r}")
    return parse_length(width), parse_length(height), MEASURED


def _ruler(text: str) -> tuple[Floats, float]:
    found = re.fullmatch(r"([0-9.]+),([0-9.]+),([0-9.]+),([0-9.]+)=(.+)", text)
    if found is None:
        raise ArgumentTypeError(
            f"takes two places and the length between them, as 210,340,1890,352=100mm, not {text!r}"
        )
    import numpy as np

    ends = np.array([float(value) for value in found.groups()[:4]]).reshape(2, 2)
    if np.linalg.norm(ends[1] - ends[0]) < 10:
        raise ArgumentTypeError("the two places are the same: choose lines of the ruler that are far apart")
    return ends, parse_length(found[5])
