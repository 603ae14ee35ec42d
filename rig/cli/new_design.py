"""rig new design: write the rig.toml of a new design.

From a radius, an arm's name, its URDF or its table of rows.
"""

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.common_options import add_overwrite_option, add_units_option, file_or_stdout
from rig.cli.shared.option_value_parsing import parse_length
from rig.formats.numbers_and_units import parse_number, parse_whole_number

if TYPE_CHECKING:
    from rig.formats.importers.arm_of_urdf_or_dh_table import ArmFileOptions


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig new design` to a parser."""
    parser.add_argument(
        "--mechanism",
        choices=("hexapod", "planar2", "arm"),
        help="hexapod (the default), two struts in a plane, or a shipped arm, with --arm",
    )
    parser.add_argument(
        "--arm",
        metavar="NAME",
        help="a shipped arm's nominal figures, with an instrument that measures it: puma560, ur10, "
        "panda, stanford, scara, gantry",
    )
    add_own_arm_options(parser)
    add_units_option(parser, "in rig.toml, and in --dh where its header states none")
    parser.add_argument(
        "--seen",
        choices=("cubes", "hand"),
        help="of an arm: by cameras, in place of an instrument: with cubes in its hand before "
        "fixed cameras, or with the cameras in its hand before fixed cubes",
    )
    parser.add_argument(
        "--radius",
        type=_radius,
        metavar="0.3",
        help="of a hexapod's circle of base joints, m, or with a unit, as 300mm; of planar2 half the joints' distance",
    )
    parser.add_argument("--cameras", type=parse_whole_number, default=3)
    parser.add_argument("--cubes", type=parse_whole_number, default=4, help="on the base, and as many on the platform")
    parser.add_argument("--size", default="1280x1024", metavar="WxH", help="of the images, px")
    parser.add_argument("--dictionary", default="DICT_5X5_100")
    parser.add_argument(
        "--limbs",
        nargs="?",
        type=parse_whole_number,
        const=6,
        default=0,
        metavar="N",
        help="with N measuring limbs next to the struts (default six; more are checks)",
    )
    parser.add_argument("--name", help="of the rig, by default its kind of machine")
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="written here, or printed")
    add_overwrite_option(parser)


def add_own_arm_options(parser: ArgumentParser) -> None:
    """Add the options that name a file of one's own arm.

    A URDF or a table of Denavit-Hartenberg rows.
    """
    parser.add_argument("--urdf", metavar="FILE.urdf", type=Path, help="your own arm, with the URDF's exact kinematics")
    parser.add_argument(
        "--tip",
        metavar="LINK",
        action="append",
        default=[],
        help="of --urdf, the link that is measured; by default its only end; repeated, the hands of one arm",
    )
    parser.add_argument("--root", metavar="LINK", help="of --urdf, the link in which poses are; by default its first")
    parser.add_argument(
        "--dh",
        metavar="FILE.csv",
        type=Path,
        help="your own arm, as a table of Denavit-Hartenberg rows with a header: theta, d, a, alpha, optional joint "
        "(revolute, prismatic), name, lower, upper; units in the header, as alpha_deg, d_mm",
    )
    parser.add_argument("--modified", action="store_true", help="of --dh, rows in Craig's convention")


def arm_file_options(arguments: Namespace, units: str | None) -> "ArmFileOptions":
    """ArmFileOptions of the arguments that `add_own_arm_options` adds.

    units : of --dh, None for its header's or SI
    Raises RigError
    """
    from rig.formats.importers.arm_of_urdf_or_dh_table import ArmFileOptions

    names = ("urdf", "root", "dh", "modified")
    given = {name: getattr(arguments, name) for name in names}
    return ArmFileOptions(**given, tips=tuple(arguments.tip), units=units)


def _radius(text: str) -> float:
    """A length in m, or with its unit."""
    try:
        return parse_number(text)
    except ValueError:
        return parse_length(text)


def run(arguments: Namespace) -> None:
    """Run `rig new design`.

    Write the rig.toml of a new design.
    """
    from rig.formats.importers.arm_of_urdf_or_dh_table import read_arm_file
    from rig.formats.numbers_and_units import SI
    from rig.formats.output_files import write_text
    from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions, new_rig_toml

    units = None if arguments.dh is None or arguments.units is None else str(arguments.units)
    own = read_arm_file(arm_file_options(arguments, units))
    options = LayoutOptions(
        mechanism=arguments.mechanism,
        arm=arguments.arm,
        seen=arguments.seen,
        radius=arguments.radius,
        cameras=arguments.cameras,
        cubes=arguments.cubes,
        size=arguments.size,
        dictionary=arguments.dictionary,
        limbs=arguments.limbs,
        name=arguments.name,
        own_arm=None if own is None else own.rig_toml(arguments.name),
        units=arguments.units or SI,
    )
    text = new_rig_toml(options)
    for line in () if own is None else own.lines:
        print(line, file=sys.stderr)
    if arguments.out is None:
        print(text, end="")
        return
    write_text(arguments.outputs.file(arguments.out), text)
    print(f"written: {arguments.out}")
