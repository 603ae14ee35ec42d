"""rig new: write a rig.toml.

A folder is filled from answers to four questions, or from options. `rig new design` writes one from a radius, or from
an arm: its name, its URDF or its table of rows.
"""

import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_length, suggestion_text
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_overwrite_option,
    add_units_option,
    file_or_stdout,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number, parse_whole_number

if TYPE_CHECKING:
    from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions
    from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions


KINDS = ("hexapod", "planar2", "arm")
CAMERAS, SIZE = "3", "1280x1024"  # what is taken where nothing is answered
T = TypeVar("T")


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig new` to a parser."""
    parser.add_argument(
        "out", metavar="FOLDER", type=Path, nargs="?", default=Path("."), help="gets rig.toml; this one by default"
    )
    parser.add_argument("--mechanism", metavar="KIND", help="hexapod, planar2 (two struts in a plane) or arm")
    parser.add_argument(
        "--radius",
        metavar="300mm",
        help="of a hexapod's circle of base joints, of planar2 half the joints' distance; with its unit",
    )
    parser.add_argument("--arm", metavar="NAME", help="in place of --radius, a shipped arm")
    parser.add_argument("--cameras", metavar="N", help="how many cameras view it")
    parser.add_argument("--size", metavar="WxH", help="of their images, px")
    parser.add_argument(
        "--defaults", action="store_true", help=f"do not ask for defaults: hexapod, {CAMERAS} cameras, {SIZE}"
    )
    add_units_option(parser, "in rig.toml")
    add_overwrite_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig new`.

    Write a new rig.toml from questions or options.

    Prompts for missing values and prints next steps. Raises RigError where something must be asked and nobody is there.
    """
    from rig.formats.numbers_and_units import SI
    from rig.formats.output_files import write_text
    from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions, new_rig_toml, shipped_arm_names

    out = arguments.out / "rig.toml"
    is_folder = arguments.out.is_dir()
    place = arguments.outputs.file(out) if is_folder else None  # refused before anything is asked
    if place is None and not arguments.out.absolute().parent.is_dir():
        raise RigError(f"{arguments.out.parent} is no folder; create it first")
    if arguments.arm is not None and arguments.mechanism is None:
        arguments.mechanism = "arm"
    kind = _answer(
        arguments,
        "mechanism",
        "What moves? hexapod (six struts), planar2 (two struts in a plane), arm",
        "hexapod",
        _one_of(KINDS),
    )
    if kind == "arm":
        name = _answer(
            arguments, "arm", f"Which arm? {', '.join(shipped_arm_names())}", None, _one_of(shipped_arm_names())
        )
        options, seen = LayoutOptions(arm=name), "its poses come from an instrument; see [instrument] in it"
    else:
        options, seen = _strut_options(arguments, kind)
    text = new_rig_toml(replace(options, units=arguments.units or SI))
    if place is None:
        arguments.out.mkdir()
        place = arguments.outputs.file(out)
    write_text(place, text)
    arguments.outputs.finish()
    _index(arguments.out)
    print(f"written: {out}; {seen}")
    print(
        "next: measure your own machine's joints, cameras and cubes and write them into it; then rig print "
        f"{out} --out sheets.pdf"
    )
    print(f"or try it without a machine: rig simulate {out} --plan sobol:40 --out REC")


def _index(folder: Path) -> None:
    """Write the page of all pages of a project that begins here, where no other index.html is."""
    from rig.formats.output_files import CommandOutputs
    from rig.report.pages.page_templates_and_index_page import KIND, NAME, write_index_page

    if not (folder / NAME).exists():
        with CommandOutputs(KIND) as outputs:
            write_index_page(outputs.file(folder / NAME), folder)


def _strut_options(arguments: Namespace, kind: str) -> tuple["LayoutOptions", str]:
    """(options of a layout of struts, remarks on it)."""
    from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions

    question = (
        "How large? radius of the circle of base joints"
        if kind == "hexapod"
        else "How large? half the distance of the base joints"
    )
    radius = _answer(arguments, "radius", f"{question}, with its unit, as 300mm", None, parse_length)
    cameras = _answer(arguments, "cameras", "How many cameras look at it?", CAMERAS, _count)
    width, height = _answer(arguments, "size", "How large are their images, px?", SIZE, _size)
    options = LayoutOptions(mechanism=kind, radius=radius, cameras=cameras, size=f"{width}x{height}")
    return options, f"{cameras} cameras and cubes placed for mutual visibility"


def _answer(arguments: Namespace, name: str, question: str, default: str | None, read: Callable[[str], T]) -> T:
    """What the option says; else the answer to the question, repeated until it can be read. Raises RigError where
    nobody can be asked.
    """
    given = getattr(arguments, name)
    if given is None and arguments.defaults:
        given = default
    if given is not None:
        try:
            return read(given)
        except (ValueError, ArgumentTypeError) as error:
            raise RigError(f"--{name}: {error}") from None
    while True:
        if not sys.stdin.isatty():
            raise RigError(f"no interactive input here: give --{name}" + (" or --defaults" if default else ""))
        print(f"{question}{f' [{default}]' if default else ''}: ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise RigError(f"no answer: give --{name}")
        try:
            return read(line.strip() or default or "")
        except (ValueError, ArgumentTypeError) as error:
            print(f"  {error}", file=sys.stderr)


def _one_of(names: list[str] | tuple[str, ...]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in names:
            raise ValueError(f"expected {', '.join(names)}, not {text!r}{suggestion_text(text, names)}")
        return text

    return read


def _count(text: str) -> int:
    if not text.isdigit() or not 1 <= int(text) <= 20:
        raise ValueError(f"expected 1 to 20 cameras, not {text!r}")
    return int(text)


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit() and int(width) >= 64 and int(height) >= 64):
        raise ValueError(f"expected for example {SIZE}, not {text!r}")
    return int(width), int(height)


def arguments_of_design(parser: ArgumentParser) -> None:
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
    add_user_arm_file_options(parser)
    add_units_option(parser, "in rig.toml, and in --dh and --poe where its header states none")
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
    parser.add_argument(
        "--struts", type=parse_whole_number, default=6, metavar="N", help="of a hexapod, six (the default) to eight"
    )
    parser.add_argument("--name", help="of the rig, by default its kind of machine")
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="written here, or printed")
    add_overwrite_option(parser)


def add_user_arm_file_options(parser: ArgumentParser) -> None:
    """Add the options that name a file of the user's own arm.

    A URDF, a table of Denavit-Hartenberg rows, or one of screw axes.
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
    parser.add_argument(
        "--poe",
        metavar="FILE.csv",
        type=Path,
        help="your own arm, as a product of exponentials: a table of screw axes with a header wx, wy, wz, vx, vy, vz, "
        "optional name, lower, upper",
    )
    parser.add_argument(
        "--home",
        metavar=("X", "Y", "Z", "RX", "RY", "RZ"),
        nargs=6,
        type=parse_number,
        help="of --poe, the hand's pose at 0, position (m) and rotation vector (rad)",
    )


def arm_file_options(arguments: Namespace, units: str | None) -> "ArmFileOptions":
    """ArmFileOptions of the arguments that `add_user_arm_file_options` adds.

    units : of --dh or --poe, None for its header's or SI
    Raises RigError
    """
    from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions

    names = ("urdf", "root", "dh", "modified", "poe")
    given = {name: getattr(arguments, name) for name in names}
    home = None if arguments.home is None else tuple(arguments.home)
    return ArmFileOptions(**given, tips=tuple(arguments.tip), units=units, home=home)


def _radius(text: str) -> float:
    """A length in m, or with its unit."""
    try:
        return parse_number(text)
    except ValueError:
        return parse_length(text)


def run_design(arguments: Namespace) -> None:
    """Run `rig new design`.

    Write the rig.toml of a new design.
    """
    from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import read_arm_file
    from rig.formats.numbers_and_units import SI
    from rig.formats.output_files import write_text
    from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions, new_rig_toml

    table = arguments.dh or arguments.poe
    units = None if table is None or arguments.units is None else str(arguments.units)
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
        struts=arguments.struts,
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
