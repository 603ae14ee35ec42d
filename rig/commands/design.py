"""rig design --radius R --out rig.toml."""


from argparse import ArgumentParser, Namespace

from rig.commands.output import add_force, file_or_stdout


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("--radius", type=float, required=True, metavar="M", help="of the circle of base joints, m")
    parser.add_argument("--cameras", type=int, default=3)
    parser.add_argument("--cubes", type=int, default=4, help="on the base, and as many on the platform")
    parser.add_argument("--size", default="1280x1024", metavar="WxH", help="of the images, px")
    parser.add_argument("--dictionary", default="DICT_5X5_100")
    parser.add_argument("--limbs", action="store_true", help="with six measuring limbs beside the struts")
    parser.add_argument("--name", default="hexapod")
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="written here, or printed")
    add_force(parser)


def run(arguments: Namespace) -> None:
    """Write or print a rig.toml."""
    import re

    from rig.errors import RigError
    from rig.files import write_text
    from rig.layout import layout

    size = re.fullmatch(r"(\d+)[xX](\d+)", arguments.size)
    if not size:
        raise RigError(f"--size takes for example 1280x1024, not {arguments.size!r}")
    text = layout(arguments.radius, arguments.cameras, int(size[1]), int(size[2]), arguments.cubes, arguments.dictionary, arguments.name,
                  arguments.limbs)
    if arguments.out is None:
        print(text, end="")
        return
    write_text(arguments.outputs.file(arguments.out), text)
    print(f"written: {arguments.out}")
