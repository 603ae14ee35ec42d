"""rig design: write the rig.toml of a new design, from a radius or an arm's name: cubes and cameras placed."""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.command_options import add_overwrite_option, file_or_stdout
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
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
    parser.add_argument(
        "--seen",
        choices=("cubes", "hand"),
        help="of an arm: by cameras, in place of an instrument: with cubes in its hand before "
        "fixed cameras, or with the cameras in its hand before fixed cubes",
    )
    parser.add_argument(
        "--radius",
        type=parse_number,
        metavar="M",
        help="of a hexapod's circle of base joints, m; of planar2 half the joints' distance",
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


def run(arguments: Namespace) -> None:
    """Write or print a rig.toml."""
    from rig.errors import RigError
    from rig.planning.layout import hexapod_layout_and_camera_placement
    from rig.planning.layout import hexapod_layout_and_camera_placement as layout

    if arguments.arm is not None or arguments.mechanism == "arm":
        _shipped(arguments)
        return
    if arguments.radius is None:
        raise RigError("a hexapod or planar2 takes --radius, an arm --arm")
    if arguments.seen is not None:
        raise RigError("--seen applies to an arm; use it with --arm")
    size = _size(arguments.size)
    kind = arguments.mechanism or "hexapod"
    if arguments.limbs < 0:
        raise RigError(f"--limbs takes a number of limbs, not {arguments.limbs}")
    if arguments.limbs and kind != "hexapod":
        raise RigError(f"--limbs belong to a hexapod's struts; a {kind} has none")
    figures = (
        arguments.radius,
        arguments.cameras,
        *size,
        arguments.cubes,
        arguments.dictionary,
        arguments.name or kind,
    )
    _write(
        arguments,
        layout.hexapod_layout_rig_toml(*figures, arguments.limbs)
        if kind == "hexapod"
        else hexapod_layout_and_camera_placement.two_strut_layout_rig_toml(*figures),
    )


def _shipped(arguments: Namespace) -> None:
    """Write or print the rig.toml of a shipped arm."""
    from rig.errors import RigError
    from rig.planning.layout import shipped_arm_layout

    if arguments.arm is None:
        raise RigError(
            "--mechanism arm takes --arm with the name of a shipped one: "
            f"{', '.join(shipped_arm_layout.shipped_arm_names())}"
        )
    if arguments.mechanism in ("hexapod", "planar2") or arguments.radius is not None:
        raise RigError(
            f"--arm brings its own figures; --mechanism {arguments.mechanism or 'hexapod'} and --radius are for struts"
        )
    if arguments.seen is None:
        _write(arguments, shipped_arm_layout.shipped_arm_rig_toml(arguments.arm))
        return
    from rig.planning.layout.shipped_arm_layout import arm_layout_rig_toml as layout

    _write(
        arguments,
        layout(
            arguments.arm,
            arguments.seen,
            arguments.cameras,
            _size(arguments.size),
            arguments.cubes,
            arguments.dictionary,
        ),
    )


def _size(text: str) -> tuple[int, int]:
    """(width, height) px of text like 1280x1024. Raises RigError for other text."""
    import re

    from rig.errors import RigError

    size = re.fullmatch(r"(\d+)[xX](\d+)", text)
    if not size:
        raise RigError(f"--size takes for example 1280x1024, not {text!r}")
    return int(size[1]), int(size[2])


def _write(arguments: Namespace, text: str) -> None:
    from rig.formats.output_files import write_text

    if arguments.out is None:
        print(text, end="")
        return
    write_text(arguments.outputs.file(arguments.out), text)
    print(f"written: {arguments.out}")
