"""Argument parser of the commands, and options that several commands share.

With the nearest known word for a mistyped option or command; outputs, calibrations, controllers, numbers of workers.
"""

from __future__ import annotations

import math
import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace, _SubParsersAction
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from rig.errors import MissingLibrary, RigError
from rig.formats.number_parsing_and_rounding import parse_number
from rig.formats.output_files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    from calib.certification.held_out_errors import HeldOut
    from rig.formats.length_and_angle_units import LengthAndAngleUnits
    from rig.report.pages.page_templates_and_elements import Link
    from vision.recording_adjustment import Measurement

PROGRESS = ("auto", "lines", "none")
PRINTED = (
    "doctor completion",
    "doctor",
    "effects",
    "status",
)  # what they print is all they are for, so they cannot be quiet

SHARED = (
    "calibrate",
    "calibrate online",
    "certify",
    "diagnose",
    "investigate",
    "limbs test",
    "measure",
    "simulate",
    "simulate blind",
    "verify",
    "watch",
    "why",
)  # work for many

INVALID = re.compile(r"invalid parse_(\w+) value")  # as argparse names what parses an argument
NEGATIVE = re.compile(r"-\.?\d[^,]*,")  # figures separated by commas, of which the first is negative


def join_negative_numbers(words: Iterable[str]) -> list[str]:
    """Join options with negative numbers: `--pose -0.1,0,0` becomes `--pose=-0.1,0,0`, as argparse needs it."""
    joined: list[str] = []
    for word in words:
        if NEGATIVE.match(word) and joined and re.fullmatch(r"--[a-z][a-z-]*", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


class Parser(ArgumentParser):
    """An ArgumentParser that knows the words it was given. words : the whole command line; command : the parser of the
    command chosen, or None
    """

    words: tuple[str, ...] = ()
    command: Parser | None = None

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; unlike argparse's own this raises OSError where it cannot."""
        print(self.format_help(), end="", file=file)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the usage, and what was probably meant, and end with status 2."""
        parser, message = (
            self.command or self,
            INVALID.sub(lambda found: f"invalid {found[1].replace('_', ' ')} value", message),
        )
        hints = [
            f"{word}: did you mean {near}?"
            for word in self.words
            if word.startswith("--") and len(word) > 2
            for near in [nearest_word(word.split("=")[0], parser.options())]
            if near
        ]
        hint = "".join(f"\n{line}" for line in hints)
        parser.exit(2, f"{parser.format_usage()}{parser.prog}: error: {message}{hint}\n")

    def options(self) -> list[str]:
        """Its long options."""
        return [name for action in self._actions for name in action.option_strings if name.startswith("--")]

    def unknown(self, word: str, commands: Iterable[str]) -> NoReturn:
        """Report that there is no such command, and the nearest one, and end with status 2."""
        self.exit(
            2,
            f"{self.prog}: error: there is no command {word!r}{suggestion_text(word, commands) or '.'} "
            f"`{self.prog} --help` lists them\n",
        )


def nearest_word(word: str, known: Iterable[str]) -> str | None:
    """Nearest known word to a mistyped one; None where none is near, or the word is known or an abbreviation."""
    found = list(known)
    if word in found or any(word.startswith("--") and name.startswith(word) for name in found):
        return None
    from difflib import get_close_matches

    return next(iter(get_close_matches(word, found, n=1, cutoff=0.6)), None)


def suggestion_text(word: str, known: Iterable[str]) -> str:
    r"""Suggestion after a mistyped word: \"; did you mean ..?\", \"\" where no known word is near."""
    near = nearest_word(word, known)
    return f"; did you mean {near}?" if near else ""


def completion_script(parser: ArgumentParser, shell: str) -> str:
    """Completion script of a shell (bash, zsh, fish) for a parser of all commands, file names where files are named."""
    import shtab

    commands = next(action for action in parser._actions if isinstance(action, _SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            if action.type is Path or getattr(action.type, "__name__", "") == "file_or_stdout":
                action.complete = shtab.FILE
    return str(shtab.complete(parser, shell))


def add_common_options(parser: ArgumentParser, command: str) -> None:
    """Add the common options of all commands (--quiet, --progress), and worker options where the command uses them."""
    if command in SHARED:
        from rig.cli.shared.worker_options_and_pool import add_worker_options

        add_worker_options(parser)
    if command in PRINTED:
        return
    parser.add_argument(
        "--quiet", action="store_true", help="print only errors, and results requested on the standard output"
    )
    parser.add_argument(
        "--progress",
        choices=PROGRESS,
        default="auto",
        metavar="|".join(PROGRESS),
        help="progress of a command and the "
        "time left: bars on a terminal (auto), lines on the error output, pipes too, or none",
    )


SEED = 0  # of the bootstrap; results are the same from run to run


def file_or_stdout(text: str) -> Path:
    """File path of an output option; `-` is standard output."""
    return STANDARD_OUTPUT if text == "-" else Path(text)


def add_overwrite_option(parser: ArgumentParser, name: str = "--force") -> None:
    """Add the option to overwrite files that the command did not make. name : of the option"""
    parser.add_argument(
        name,
        dest="overwrite",
        action="store_true",
        help="overwrite files that this command did not make; it never overwrites its inputs",
    )


def add_units_option(parser: ArgumentParser, what: str) -> None:
    """Add the option --units of lengths and angles. what : has them, in words"""
    parser.add_argument(
        "--units",
        metavar="mm,deg",
        type=_parse_units,
        help=f"units of lengths (m, mm, cm, um, in) and angles (rad, deg, mrad) {what} (default m,rad)",
    )


def _parse_units(text: str) -> LengthAndAngleUnits:
    from rig.formats.length_and_angle_units import parse_length_and_angle_units

    try:
        return parse_length_and_angle_units(text)
    except ValueError as error:
        raise ArgumentTypeError(f"expected {error}") from None


def add_page_option(parser: ArgumentParser) -> None:
    """Add the option --page FILE."""
    parser.add_argument(
        "--page", metavar="FILE", type=Path, help="a page of it, written here: one file that needs no network"
    )


def page_path(arguments: Namespace) -> Path | None:
    """Path of the page to write, None where none is requested. Raises RigError where it cannot be written."""
    return None if arguments.page is None else arguments.outputs.file(arguments.page)


def page_links(arguments: Namespace, page_file: Path) -> list[Link]:
    """Links of a command's page: to the index above it and to the pages of the command's inputs."""
    from rig.report.pages.page_templates_and_elements import index_and_source_links as links

    return links(page_file, arguments.outputs.inputs)


def add_json_option(parser: ArgumentParser) -> None:
    """Add the option --json."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON (SI units, rad) instead of text")


def add_json_result_option(parser: ArgumentParser) -> None:
    """Add the option --json for a command that leaves its result in `arguments.result`, printed at its end."""
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the result as JSON (SI units, rad) when all is done; text goes to the error output",
    )
    parser.set_defaults(result=None)


def print_json(tree: object) -> None:
    """Print a result as JSON; NaN becomes null."""
    import json

    from rig.formats.json_toml_and_yaml_loading import nan_to_null

    print(json.dumps(nan_to_null(tree), indent=1))


def parse_length(text: str) -> float:
    """Parse a length with its unit, such as 20um, 0.02mm or 2e-5m, in m. Raises ArgumentTypeError for anything else."""
    for unit, scale in (("um", 1e-6), ("mm", 1e-3), ("m", 1.0)):
        if text.endswith(unit):
            try:
                value = parse_number(text.removesuffix(unit)) * scale
            except ValueError:
                break
            if 0 < value < float("inf"):
                return value
            break
    raise ArgumentTypeError(f"expected a length above 0 with its unit, 20um, 0.02mm or 2e-5m, not {text!r}")


TOLERANCE_UNITS = {
    "um": ("position", 1e-6),
    "mm": ("position", 1e-3),
    "m": ("position", 1.0),
    "urad": ("rotation", 1e-6),
    "arcsec": ("rotation", math.pi / 648000),
    "mrad": ("rotation", 1e-3),
    "rad": ("rotation", 1.0),
}


def parse_tolerance(text: str) -> tuple[str, float]:
    r"""Parse a tolerance such as 20um or 0.1mrad: (\"position\", m) or (\"rotation\", rad). Raises ArgumentTypeError"""
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]+)\s*", text)
    if found is None or found[2] not in TOLERANCE_UNITS or not 0 < float(found[1]) < 1e9:
        units = ", ".join(TOLERANCE_UNITS)
        raise ArgumentTypeError(f"{text!r} is not a tolerance; write a number > 0 and {units}, as in 20um")
    kind, scale = TOLERANCE_UNITS[found[2]]
    return kind, float(found[1]) * scale


def length_and_angle(texts: Sequence[str]) -> tuple[float, float]:
    """Tolerances (m, rad) of an option that takes a length and an angle: 50um 0.2mrad, or two figures in m and rad.

    Raises RigError for anything else
    """
    try:
        plain = [parse_number(text) for text in texts]
    except ValueError:
        try:
            found = dict(parse_tolerance(text) for text in texts)
        except ArgumentTypeError as error:
            raise RigError(f"--tolerance: {error}") from None
        if len(found) != 2:
            raise RigError(f"--tolerance takes a length and an angle, as 50um 0.2mrad, not {' '.join(texts)}") from None
        return found["position"], found["rotation"]
    if len(plain) != 2 or not all(0 < value < float("inf") for value in plain):
        raise RigError(f"--tolerance takes a length and an angle, as 50um 0.2mrad, not {' '.join(texts)}")
    return plain[0], plain[1]


def parse_numbers(texts: list[str], count: int, option: str) -> list[float]:
    """Parse `count` numbers of an option, separated by commas or spaces. Raises RigError for anything else"""
    try:
        found = [parse_number(word) for word in re.split(r"[,\s]+", " ".join(texts).strip(", "))]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(value) < 1e6 for value in found):
        raise RigError(f"{option} takes {count} numbers, separated by commas or spaces, not {' '.join(texts)!r}")
    return found


def add_controller_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of commands that talk to the controller: RIG.toml, --port, --trace."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    add_port_and_trace_options(parser)


def add_port_and_trace_options(parser: ArgumentParser) -> None:
    """Add the options --port of the controller, and --trace FILE of the bytes exchanged."""
    parser.add_argument(
        "--port", help="controller address, instead of the one in [controller]: a device, socket://.., rfc2217://.."
    )
    parser.add_argument("--trace", metavar="FILE", type=Path, help="write every byte there, with its time")


def add_speed_option(parser: ArgumentParser, usual: float) -> None:
    """Add the option --speed, a share of the struts' greatest speed."""
    parser.add_argument(
        "--speed",
        type=parse_number,
        default=usual,
        metavar="SHARE",
        help=f"of the struts' greatest speed (default {usual:g})",
    )


def add_trust_unhomed_position_option(parser: ArgumentParser) -> None:
    """Add the option --trust: trust the position that the controller reports, though it was not homed."""
    parser.add_argument(
        "--trust", action="store_true", help="trust the position that the controller reports, though it was not homed"
    )


def require_share(speed: float) -> float:
    """Require a share of the greatest speed to lie within (0, 1]. Raises RigError for anything else"""
    if not 0 < speed <= 1:
        raise RigError(f"--speed takes a share above 0 and up to 1, got {speed:g}")
    return speed


def print_held_out_errors(held_out: HeldOut, title: str) -> None:
    """Print held-out errors before and after correction as a table in mm and mrad."""
    from calib.certification.calibration_dataclass_and_claim_sentences import ratio_interval_text

    names = ("mean", "RMS", "95 %", "max")
    print(f"{title}, N = {held_out.after.n}, {held_out.configurations} distinct configurations:")
    print(f"{'':14}{'position, mm':>40}{'rotation, mrad':>43}")
    print(f"{'':14}" + "".join(f"{name:>10}" for name in names) + "   " + "".join(f"{name:>10}" for name in names))
    for name, figures in (("nominal model", held_out.before), ("corrected", held_out.after)):
        position, rotation = (figures.mean[0], *figures.position), (figures.mean[1], *figures.rotation)
        print(f"{name:14}" + "".join(map(_cell, position)) + "   " + "".join(map(_cell, rotation)))
    turned = "; rotations were not measured"
    if held_out.floor[1] < 1:
        turned = f" and {held_out.floor[1] * 1e3:.4f} mrad" if held_out.floor[1] else "; it does not turn"
    placed = f"{held_out.floor[0] * 1e3:.4f} mm" if held_out.floor[0] < 1 else ""
    words = f"{placed}{turned}" if placed else f"{turned.removeprefix(' and ')}; positions were not measured"
    print(
        f"on these poses {ratio_interval_text(held_out.ratio)}; the measured poses themselves are uncertain by {words}"
    )


def _cell(value: float) -> str:
    return f"{value * 1e3:10.4f}" if value == value else f"{'-':>10}"


def require_matplotlib(drawings: str) -> None:
    """Require matplotlib: raise MissingLibrary where it is not installed.

    drawings : what is to be drawn, in the plural
    """
    problem = missing_matplotlib_reason()
    if problem:
        raise MissingLibrary(f"{drawings} {problem}")


def missing_matplotlib_reason() -> str | None:
    """Reason to print where matplotlib is missing; None where it is installed."""
    from importlib.util import find_spec

    return None if find_spec("matplotlib") else "are drawn by matplotlib: pip install 'rig[print]'"


def print_frames_without_pose(measurement: Measurement | None) -> None:
    """Print the frames without a pose of a Measurement, with their reasons."""
    if measurement is None or not measurement.unsolved:
        return
    print(f"{len(measurement.unsolved)} frames without a pose:")
    for frame, reason in sorted(measurement.unsolved.items())[:20]:
        print(f"  frame {frame}: {reason}")
    if len(measurement.unsolved) > 20:
        print(f"  and {len(measurement.unsolved) - 20} more")
