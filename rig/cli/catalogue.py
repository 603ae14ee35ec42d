"""rig catalogue: write the catalogue of effects as a document: model, parameters, experiment, remedy, sketch."""

from argparse import ArgumentParser, Namespace

from rig.cli.shared import input_file_options
from rig.cli.shared.command_options import add_overwrite_option, file_or_stdout
from rig.formats.output_files import STANDARD_OUTPUT


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument(
        "--out",
        metavar="FILE.md",
        type=file_or_stdout,
        default=STANDARD_OUTPUT,
        help="where it is written, as Markdown, with a "
        "sketch of each effect in a folder FILE next to it; printed without sketches by default",
    )
    input_file_options.add_effects_option(parser)
    add_overwrite_option(parser)


def run(arguments: Namespace) -> None:
    """Write the catalogue of unmodelled effects as a document: all that `rig effects NAME` says of each, with a sketch
    that its model draws.
    """
    from rig.effects.catalogue.effect_list import catalogue_markdown
    from rig.errors import RigError
    from rig.formats.output_files import write_text
    from rig.formats.output_files.atomic_file_and_manifest import is_written_directly

    kinds = input_file_options.known_effects(input_file_options.load_effect_files(arguments))
    out = arguments.outputs.file(arguments.out)
    if is_written_directly(out):
        return write_text(out, catalogue_markdown(kinds.values()))
    if not arguments.out.suffix:
        raise RigError(
            f"{arguments.out} has no suffix, and a folder of the same name next to it would hold the "
            f"sketches: name it {arguments.out}.md"
        )
    from rig.report.pages.page_templates_and_page_index import standalone_svg
    from vision.frame_and_effect_pictures import effect_sketch

    folder, sketches = arguments.out.with_suffix(""), {}
    place = arguments.outputs.folder(folder)
    for name, kind in kinds.items():
        try:
            sketch = effect_sketch(kind)
        except RigError as error:
            sketches[name] = f"No sketch: {error}."
            continue
        write_text(place / f"{name}.svg", standalone_svg(f"what {kind.label()} does", sketch.words, sketch.figures))
        sketches[name] = f"![What {kind.label()} does: {sketch.words}]({folder.name}/{name}.svg)"
    write_text(out, catalogue_markdown(kinds.values(), sketches))
    print(f"written: {arguments.out}, {folder}/")
