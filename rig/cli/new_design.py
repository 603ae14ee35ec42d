"""rig new design: write the rig.toml of a new design from a radius or an arm name: cameras and cubes placed."""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.argument_parser_and_common_options import add_overwrite_option, file_or_stdout
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number


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
    """Run `rig new design`: write the rig.toml of a new design."""
    from rig.formats.output_files import write_text
    from rig.planning.layout.shipped_arm_layout import LayoutOptions, hexapod_two_strut_or_arm_rig_toml

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
    )
    text = hexapod_two_strut_or_arm_rig_toml(options)
    if arguments.out is None:
        print(text, end="")
        return
    write_text(arguments.outputs.file(arguments.out), text)
    print(f"written: {arguments.out}")
