"""--effects FILE: effects of a user's own beside the catalogue, for the commands that take them."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    from calib.files.calibration_file import Calibration
    from rig.effects.texts.effect_text import Kinds
    from rig.effects.texts.user_effect_files import Plugin


def add_effects_option(parser: ArgumentParser) -> None:
    """Let a command take files of effects."""
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        type=Path,
        action="append",
        default=[],
        help="a file with effects of your own, as `rig effects --new` writes one; it is run; may be given again",
    )


def load_effect_files(arguments: Namespace) -> tuple[Plugin, ...]:
    """The files that were named, read and checked. Raises FileError, with the line, for what is wrong with one."""
    if not arguments.effects:
        return ()
    from rig.effects.texts.user_effect_files import load_effect_file

    return tuple(load_effect_file(path) for path in arguments.effects)


def known_effects(given: tuple[Plugin, ...]) -> Kinds:
    """{name: class} of all effects that there are with these files. Raises FileError for a name given twice."""
    if not given:
        from rig.effects.catalogue.effect_list import BY_NAME

        return BY_NAME
    from rig.effects.texts.user_effect_files import catalogue_with_files

    return catalogue_with_files(given)


def load_calibration(path: Path, given: tuple[Plugin, ...]) -> Calibration:
    """Calibration of a file, which may know effects of these files. Raises RigError where one is not as it was when the
    calibration was made.
    """
    from calib.files import calibration_file

    found = calibration_file.load(path, known_effects(given))
    hashes = found.provenance.get("inputs_sha256", {}).values()
    used = {effect.name for effect in found.physics.effects} if found.physics is not None else set()
    for plugin in given:
        if plugin.sha256 not in hashes and used & {kind.name for kind in plugin.kinds}:
            raise RigError(
                f"{plugin.path} is not as it was when {path} was made from it; take that file, or calibrate again"
            )
    return found
