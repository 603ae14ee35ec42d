"""rig effects: list and document the known unmodelled effects.

Or print one effect in full, or write a file for an effect of one's own. The document states model, parameters,
experiment, remedy and sketch of each.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import input_file_options_and_loading
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_option,
    add_overwrite_option,
    file_or_stdout,
    print_json,
)
from rig.errors import RigError
from rig.formats.output_files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from rig.effects.framework.effect_base_class import Effect
    from rig.effects.sketches import Sketch


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig effects` to a parser."""
    parser.add_argument("name", metavar="NAME", nargs="?", help="one of them in full; without it a table of all")
    add_json_option(parser)
    input_file_options_and_loading.add_user_effect_files_option(parser)
    parser.add_argument(
        "--new", metavar="NAME", help="write a file with a user-defined effect, to be edited and passed to --effects"
    )
    parser.add_argument(
        "--from",
        metavar="DIR",
        type=Path,
        dest="source",
        help="with --new: the formula that a diagnosis suggests, DIR is what rig diagnose wrote; otherwise an example",
    )
    parser.add_argument(
        "--place", metavar="PLACE", help="with --from: which suggestion, by its place, where there are several"
    )
    parser.add_argument("--out", metavar="FILE.py", type=Path, help="with --new: where to write it, by default NAME.py")
    add_overwrite_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig effects`.

    List the effects, print one in full, or write a file for a new one.
    """
    if arguments.new is not None:
        return _new(arguments)
    if arguments.source is not None or arguments.place is not None or arguments.out is not None:
        raise RigError("--from, --place and --out apply to a new effect: name it with --new")
    from shutil import get_terminal_size

    from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import suggestion_text
    from rig.effects.catalogue.effect_list import effect_description, effect_description_dict, effect_table

    width = get_terminal_size((160, 24)).columns
    known = input_file_options_and_loading.known_effects(input_file_options_and_loading.load_effect_files(arguments))
    if arguments.name is None:
        if arguments.json:
            print_json([effect_description_dict(effect) for effect in known.values()])
        else:
            print(effect_table(known.values(), width), end="")
        return
    if arguments.name not in known:
        raise RigError(
            f"there is no effect {arguments.name!r}{suggestion_text(arguments.name, known)} `rig effects` lists them"
        )
    effect = known[arguments.name]
    if arguments.json:
        print_json(effect_description_dict(effect))
    else:
        print(effect_description(effect, width), end="")


def _new(arguments: Namespace) -> None:
    """Write a file with a new effect: as a diagnosis suggests it, or an example."""
    from rig.effects.texts.effect_file_from_formula import new_effect_from_suggestion_or_example
    from rig.formats.output_files import write_text

    if arguments.name is not None or arguments.json:
        raise RigError("--new writes a file; omit NAME and --json")
    path = Path(f"{arguments.new}.py") if arguments.out is None else arguments.out
    made = new_effect_from_suggestion_or_example(arguments.new, path, arguments.source, arguments.place)
    write_text(arguments.outputs.file(path), made.source)
    print(f"written: {path}, {made}")
    print(f"rig diagnose REC --out DIR --effects {path}")
    print(f"rig simulate RIG.toml --effects {path} --effect {made.argument} --out REC")


def arguments_of_document(parser: ArgumentParser) -> None:
    """Add the arguments of `rig effects document` to a parser."""
    parser.add_argument(
        "--out",
        metavar="FILE.md",
        type=file_or_stdout,
        default=STANDARD_OUTPUT,
        help="where it is written, as Markdown, with a "
        "sketch of each effect in a folder FILE next to it; printed without sketches by default",
    )
    input_file_options_and_loading.add_user_effect_files_option(parser)
    add_overwrite_option(parser)


def run_document(arguments: Namespace) -> None:
    """Run `rig effects document`.

    Write the catalogue of effects as a document. Raises RigError for a name without a suffix.
    """
    from rig.api import effect_catalogue
    from rig.errors import RigError
    from rig.formats.output_files import write_text
    from rig.formats.output_files.atomic_file_writing_and_process_locks import is_path_written_without_staging

    kinds = input_file_options_and_loading.known_effects(input_file_options_and_loading.load_effect_files(arguments))
    out = arguments.outputs.file(arguments.out)
    printed = is_path_written_without_staging(out)
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


def _sketches() -> Callable[[type[Effect]], Sketch]:
    """The function that draws the sketch of an effect."""
    from calib.report.pose_and_effect_figures import effect_sketch

    return effect_sketch
