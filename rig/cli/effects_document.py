"""rig effects document: write the effects as a document.

Of each effect in the catalogue: model, parameters, experiment, remedy, sketch.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING

from rig.cli.shared import input_options
from rig.cli.shared.common_options import add_overwrite_option, file_or_stdout
from rig.formats.output_files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from rig.effects.framework.effect import Effect
    from rig.effects.sketches import Sketch


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig effects document` to a parser."""
    parser.add_argument(
        "--out",
        metavar="FILE.md",
        type=file_or_stdout,
        default=STANDARD_OUTPUT,
        help="where it is written, as Markdown, with a "
        "sketch of each effect in a folder FILE next to it; printed without sketches by default",
    )
    input_options.add_user_effect_files_option(parser)
    add_overwrite_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig effects document`.

    Write the catalogue of effects as a document.
    """
    from rig.api import effect_catalogue
    from rig.errors import RigError
    from rig.formats.output_files import write_text
    from rig.formats.output_files.atomic_file_and_manifest import is_written_directly

    kinds = input_options.known_effects(input_options.load_effect_files(arguments))
    out = arguments.outputs.file(arguments.out)
    printed = is_written_directly(out)
    if not printed and not arguments.out.suffix:
        raise RigError(
            f"{arguments.out} has no suffix, and a folder of the same name next to it would hold the "
            f"sketches: name it {arguments.out}.md"
        )
    folder = arguments.out.with_suffix("")
    place = None if printed else arguments.outputs.folder(folder)
    made = effect_catalogue(kinds, folder.name, None if place is None else _sketches())
    if place is not None:
        for name, svg in made.sketches.items():
            write_text(place / f"{name}.svg", svg)
    write_text(out, made.markdown)
    if place is not None:
        print(f"written: {arguments.out}, {folder}/")


def _sketches() -> "Callable[[type[Effect]], Sketch]":
    """The function that draws the sketch of an effect."""
    from calib.report.pose_and_effect_figures import effect_sketch

    return effect_sketch
