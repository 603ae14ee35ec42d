"""rig catalogue [--out FILE.md]."""

from argparse import ArgumentParser, Namespace

from rig.commands import own_effects
from rig.commands.output import add_force, file_or_stdout
from rig.files import STANDARD_OUTPUT


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("--out", metavar="FILE.md", type=file_or_stdout, default=STANDARD_OUTPUT, help="where it is written, as Markdown, with a "
                        "sketch of each effect in a folder FILE beside it; printed without sketches by default")
    own_effects.argument(parser)
    add_force(parser)


def run(arguments: Namespace) -> None:
    """Write the catalogue of left-out physics as a document: all that `rig effects NAME` says of each, with a sketch that its model draws."""
    from rig.effects.catalogue import page
    from rig.errors import RigError
    from rig.files import write_text
    from rig.files.whole import is_straight

    kinds = own_effects.known(own_effects.plugins(arguments))
    out = arguments.outputs.file(arguments.out)
    if is_straight(out):
        return write_text(out, page(kinds.values()))
    if not arguments.out.suffix:
        raise RigError(f"{arguments.out} has no ending, and a folder beside it of the same name would hold the sketches: name it {arguments.out}.md")
    from rig.page.alone import alone
    from vision.sketch import drawn

    folder, sketches = arguments.out.with_suffix(""), {}
    place = arguments.outputs.folder(folder)
    for name, kind in kinds.items():
        try:
            sketch = drawn(kind)
        except RigError as error:
            sketches[name] = f"No sketch: {error}."
            continue
        write_text(place / f"{name}.svg", alone(f"what {kind.label()} does", sketch.words, sketch.figures))
        sketches[name] = f"![What {kind.label()} does: {sketch.words}]({folder.name}/{name}.svg)"
    write_text(out, page(kinds.values(), sketches))
    print(f"written: {arguments.out}, {folder}/")
