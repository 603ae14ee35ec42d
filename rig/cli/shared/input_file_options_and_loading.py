"""Options that name input files, and the loading of these."""

from __future__ import annotations

import sys
from argparse import SUPPRESS, ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_whole_number

if TYPE_CHECKING:
    from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource
    from rig.effects.catalogue.effect_list import Plugin
    from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
    from rig.recording.recording_folder import Recording


CHECK_EVERY = 5  # poses between two checks by vision


def add_recording_argument(parser: ArgumentParser, text: str | None = None) -> None:
    """Add the recording argument REC.

    And the options that leave out frames or images. text : help, or None
    """
    parser.add_argument("recording", metavar="REC", type=Path, help=text)
    _add_left_out(parser)


def add_recordings_argument(parser: ArgumentParser) -> None:
    """Add the arguments REC.., several recordings of one rig.

    `recording` is the first, `further` the others.
    """
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument(
        "further",
        metavar="REC",
        type=Path,
        nargs="*",
        help="more recordings of the same rig, in the order in which they were "
        "taken: days apart, with other payloads, cameras moved between them or not",
    )
    _add_left_out(parser)


def _add_left_out(parser: ArgumentParser) -> None:
    parser.add_argument("--skip-unreadable", action="store_true", help="exclude, and list, unusable images")
    parser.add_argument(
        "--mask", metavar="FRAMES", help="exclude these frames, for example 3,7-9: those known to be spoilt"
    )


def read_recording(arguments: Namespace, path: Path | None = None) -> Recording:
    """Read a recording, by default that of the arguments.

    Omitted images are named on standard error.
    """
    import rig

    found = rig.load(path or arguments.recording, arguments.skip_unreadable, arguments.mask)
    for image in found.skipped:
        print(f"excluded, as requested: {image.path}: {image.problem}", file=sys.stderr)
    return found


def add_continue_despite_mistakes_option(parser: ArgumentParser) -> None:
    """Add the option --anyway, to continue despite mistakes in the recording."""
    parser.add_argument(
        "--anyway",
        action="store_true",
        help="continue although the recording shows a mistake that makes results meaningless",
    )


def read_recordings(arguments: Namespace) -> list[Recording]:
    """The Recordings of the arguments that `add_recordings_argument` adds.

    Raises RigError for --mask with several
    """
    if arguments.further and arguments.mask is not None:
        raise RigError(
            "--mask names frames of one recording; with several, mask them one by one (rig measure REC "
            "--mask FRAMES --out ..)"
        )
    return [read_recording(arguments, path) for path in (arguments.recording, *arguments.further)]


def notice_printing_function(progress: Progress) -> Callable[[str], None]:
    """Function that prints a notice of a computation.

    The progress bar is removed first.
    """

    def notice(line: str) -> None:
        progress.close()
        print(line, flush=True)

    return notice


def add_deprecated_option_name(parser: ArgumentParser, name: str, dest: str, read: Callable[[str], object]) -> None:
    """Add a deprecated name of an option, hidden from the help, with the same destination.

    dest : of the option; read : parses its value
    """
    parser.add_argument(name, dest=dest, type=read, default=SUPPRESS, help=SUPPRESS)


def add_limb_options(parser: ArgumentParser) -> None:
    """Add the limb options to a parser.

    --limbs FILE as the source of poses, --check N for vision checks.
    """
    parser.add_argument(
        "--limbs",
        metavar="FILE",
        type=Path,
        help="poses from measuring limbs that `rig limbs test` accepted and saved here; "
        "vision checks some, and the acceptance is withdrawn where they no longer agree",
    )
    parser.add_argument(
        "--vision-every",
        dest="check",
        type=parse_whole_number,
        metavar="N",
        help=f"with --limbs: vision measures every Nth pose at least (default {CHECK_EVERY})",
    )
    add_deprecated_option_name(parser, "--check", "check", parse_whole_number)


def limb_source(arguments: Namespace) -> LimbSource | None:
    """Source of limb readings (LimbSource) that the arguments name, None where they name none.

    It replaces vision (--limbs).
    Raises RigError.
    """
    if arguments.check is not None and (arguments.limbs is None or arguments.check < 1):
        raise RigError("--vision-every takes a number of poses, at least 1, and --limbs")
    if arguments.limbs is None:
        return None
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource

    return LimbSource(arguments.limbs, arguments.check or CHECK_EVERY)


def add_user_effect_files_option(parser: ArgumentParser) -> None:
    """Add the option --effects FILE.py, a file of the user's own effects."""
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        type=Path,
        action="append",
        default=[],
        help="a file with user-defined effects, as `rig effects --new` writes one; it is run; may be repeated",
    )


def load_effect_files(arguments: Namespace) -> tuple[Plugin, ...]:
    """Load the effect files that --effects names.

    Raises FileError, with the line, for an error in one.
    """
    if not arguments.effects:
        return ()
    from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import load_effect_file

    return tuple(load_effect_file(path) for path in arguments.effects)


def known_effects(effect_files: tuple[Plugin, ...]) -> Kinds:
    """Known effects {name: class}.

    Catalogue and effect files.
    Raises FileError for a name given twice.
    """
    if not effect_files:
        from rig.effects.catalogue.effect_list import BY_NAME

        return BY_NAME
    from rig.effects.catalogue.effect_list import effect_catalogue_with_user_files

    return effect_catalogue_with_user_files(effect_files)


def load_calibration(path: Path, effect_files: tuple[Plugin, ...], several_hands: bool = False) -> Calibration:
    """Load a calibration that may use effects of these files.

    Raises RigError where such a file has changed since.
    """
    from calib.files import calibration_file

    found = calibration_file.load(path, known_effects(effect_files), several_hands)
    hashes = found.provenance.get("inputs_sha256", {}).values()
    used = {effect.name for effect in found.physics.effects} if found.physics is not None else set()
    for plugin in effect_files:
        if plugin.sha256 not in hashes and used & {kind.name for kind in plugin.kinds}:
            raise RigError(f"{plugin.path} has changed since {path} was made from it; use that file, or recalibrate")
    return found


def calibration_of_arguments(arguments: Namespace) -> Calibration:
    """Calibration that the argument CALIBRATION names, with the effects of --effects.

    Of one hand or, where the command has --hand, several.
    Raises as `load_calibration`
    """
    return load_calibration(arguments.calibration, load_effect_files(arguments), "hand" in arguments)
