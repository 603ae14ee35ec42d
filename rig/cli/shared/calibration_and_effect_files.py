"""Calibration and effect files that commands read: option --effects, loading, refutations of a calibration."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.output_files.folder_manifest import file_digest
from rig.report.verdict_and_refutations_of_results import State

if TYPE_CHECKING:
    from calib.certification.calibration_and_claim_sentences import Calibration
    from rig.effects.texts.effect_text_and_dict import Kinds
    from rig.effects.texts.user_effect_file_loading import Plugin
    from rig.report.verdict_and_refutations_of_results import Refutation


def add_effects_option(parser: ArgumentParser) -> None:
    """Add the option --effects FILE.py, a file of the user's own effects."""
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        type=Path,
        action="append",
        default=[],
        help="a file with effects of your own, as `rig effects --new` writes one; it is run; may be given again",
    )


def load_effect_files(arguments: Namespace) -> tuple[Plugin, ...]:
    """Load the effect files that --effects names. Raises FileError, with the line, for an error in one."""
    if not arguments.effects:
        return ()
    from rig.effects.texts.user_effect_file_loading import load_effect_file

    return tuple(load_effect_file(path) for path in arguments.effects)


def known_effects(effect_files: tuple[Plugin, ...]) -> Kinds:
    """Known effects {name: class}: catalogue and effect files. Raises FileError for a name given twice."""
    if not effect_files:
        from rig.effects.catalogue.effect_list import BY_NAME

        return BY_NAME
    from rig.effects.texts.user_effect_file_loading import catalogue_with_files

    return catalogue_with_files(effect_files)


def load_calibration(path: Path, effect_files: tuple[Plugin, ...]) -> Calibration:
    """Load a calibration that may use effects of these files. Raises RigError where such a file has changed since."""
    from calib.files import calibration_file

    found = calibration_file.load(path, known_effects(effect_files))
    hashes = found.provenance.get("inputs_sha256", {}).values()
    used = {effect.name for effect in found.physics.effects} if found.physics is not None else set()
    for plugin in effect_files:
        if plugin.sha256 not in hashes and used & {kind.name for kind in plugin.kinds}:
            raise RigError(
                f"{plugin.path} is not as it was when {path} was made from it; take that file, or calibrate again"
            )
    return found


def calibration_of_arguments(arguments: Namespace) -> Calibration:
    """Calibration that the argument CALIBRATION names, with the effects of --effects. Raises as `load_calibration`"""
    return load_calibration(arguments.calibration, load_effect_files(arguments))


def read_refutations(path: Path) -> tuple[Refutation, ...]:
    """Read the refutations of a calibration file, print each as a warning. Raises FileError for an invalid list."""
    from rig.report.verdict_and_refutations_of_results import refutations_of_file

    found = refutations_of_file(path)
    print_refutations(path, found)
    return found


def print_refutations(path: Path, refutations: tuple[Refutation, ...]) -> None:
    """Print on the error output what later recordings found against a calibration's file."""
    for one in refutations:
        print(f"warning: {path} was {one.line}", file=sys.stderr)


def write_refutation(arguments: Namespace, path: Path, recording: str, finding: str, state: State = State.BAD) -> None:
    """Write a refutation of a calibration by a recording's finding into its folder; warns where that fails.

    finding : a sentence without its full stop; state : BAD where it is refuted, CHECK where it leaves something out
    """
    from rig.report.verdict_and_refutations_of_results import NAME, Refutation, add_refutation

    new = Refutation(
        file_digest(path), path.name, datetime.now(UTC).date().isoformat(), arguments.command, recording, finding, state
    )
    try:
        add_refutation(arguments.outputs.file(path.parent / NAME, own=True), path.parent, new)
    except RigError as error:
        print(f"warning: {path} was {new.line}; that could not be written beside it: {error}", file=sys.stderr)
        return
    print(
        f"{path} is marked as {'refuted' if state == State.BAD else 'doubted'} in {path.parent / NAME}", file=sys.stderr
    )
