"""Argument parser of commands, parsing of option values, and shell completion.

With the nearest known word for a mistyped option or command, and completion scripts of shells.
"""

from __future__ import annotations

import math
import re
from argparse import ArgumentParser, ArgumentTypeError, _SubParsersAction
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from rig.errors import RigError
from rig.formats.numbers_and_units import SUFFIXES, parse_number, parse_quantity

if TYPE_CHECKING:
    from _typeshed import SupportsWrite


INVALID = re.compile(r"invalid parse_(\w+) value")  # as argparse names what parses an argument
NEGATIVE = re.compile(r"-\.?\d(?:[^,]*,|[-+.\deE]*[a-zµμ]+$)")  # -2mm, or figures with commas of which the first is < 0


def join_options_with_negative_numbers(words: Iterable[str]) -> list[str]:
    """Join options with negative numbers that follow them.

    `--pose -0.1,0,0` becomes `--pose=-0.1,0,0`, as argparse needs it.
    """
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
            for near in [nearest_known_word_if_mistyped(word.split("=")[0], parser.options())]
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


def nearest_known_word_if_mistyped(word: str, known: Iterable[str]) -> str | None:
    """Nearest known word to a mistyped one.

    None where none is near, or the word is known or an abbreviation.
    """
    found = list(known)
    if word in found or any(word.startswith("--") and name.startswith(word) for name in found):
        return None
    from difflib import get_close_matches

    return next(iter(get_close_matches(word, found, n=1, cutoff=0.6)), None)


def suggestion_text(word: str, known: Iterable[str]) -> str:
    r"""Suggestion text after a mistyped word.

    As in "; did you mean ..?"; "" where no known word is near.
    """
    near = nearest_known_word_if_mistyped(word, known)
    return f"; did you mean {near}?" if near else ""


def completion_script(parser: ArgumentParser, shell: str) -> str:
    """Completion script of a shell (bash, zsh, fish) for a parser of all commands.

    File names where files are named.
    """
    import shtab

    commands = next(action for action in parser._actions if isinstance(action, _SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            if action.type is Path or getattr(action.type, "__name__", "") == "file_or_stdout":
                action.complete = shtab.FILE
    return str(shtab.complete(parser, shell))


def parse_length(text: str) -> float:
    """Parse a length with its unit, such as 20um, 0.02mm or 2e-5m, in m.

    Raises ArgumentTypeError for anything else.
    """
    try:
        value = parse_quantity(text, "m", math.nan)  # a number alone is no length
    except ValueError:
        value = math.nan
    if 0 < value < float("inf"):
        return value
    raise ArgumentTypeError(f"expected a length above 0 with its unit, 20um, 0.02mm or 2e-5m, not {text!r}")


def make_quantity_parser(unit: str, plain: str) -> Callable[[str], float]:
    """Function that parses an option's quantity in an SI unit, with or without a unit after the number.

    plain : unit of a number alone, one of SUFFIXES[unit]
    """
    units = ", ".join(SUFFIXES[unit])

    def parse(text: str) -> float:
        try:
            return parse_quantity(text, unit, SUFFIXES[unit][plain])
        except ValueError:
            message = f"expected a number with its unit ({units}), or in {plain} without, not {text!r}"
            raise ArgumentTypeError(message) from None

    return parse


TOLERANCE_UNITS = {
    name: (kind, scale)
    for kind, unit in (("position", "m"), ("rotation", "rad"))
    for name, scale in SUFFIXES[unit].items()
}


def parse_tolerance(text: str) -> tuple[str, float]:
    """Parse a tolerance such as 20um or 0.1mrad.

    Returns ("position", m) or ("rotation", rad)
    Raises ArgumentTypeError
    """
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]+)\s*", text)
    if found is None or found[2] not in TOLERANCE_UNITS or not 0 < float(found[1]) < 1e9:
        units = ", ".join(TOLERANCE_UNITS)
        raise ArgumentTypeError(f"{text!r} is not a tolerance; write a number > 0 and {units}, as in 20um")
    kind, scale = TOLERANCE_UNITS[found[2]]
    return kind, float(found[1]) / scale


def parse_length_and_angle(texts: Sequence[str], option: str = "--tolerance") -> tuple[float, float]:
    """Parse a length and an angle of an option, as (m, rad).

    50um 0.2mrad, or two figures in m and rad.

    Raises RigError for anything else
    """
    try:
        plain = [parse_number(text) for text in texts]
    except ValueError:
        try:
            found = dict(parse_tolerance(text) for text in texts)
        except ArgumentTypeError as error:
            raise RigError(f"{option}: {error}") from None
        if len(found) != 2:
            raise RigError(f"{option} takes a length and an angle, as 50um 0.2mrad, not {' '.join(texts)}") from None
        return found["position"], found["rotation"]
    if len(plain) != 2 or not all(0 < value < float("inf") for value in plain):
        raise RigError(f"{option} takes a length and an angle, as 50um 0.2mrad, not {' '.join(texts)}")
    return plain[0], plain[1]


def parse_numbers(texts: list[str], count: int, option: str) -> list[float]:
    """Parse `count` numbers of an option, separated by commas or spaces.

    Raises RigError for anything else
    """
    try:
        found = [parse_number(word) for word in re.split(r"[,\s]+", " ".join(texts).strip(", "))]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(value) < 1e6 for value in found):
        raise RigError(f"{option} takes {count} numbers, separated by commas or spaces, not {' '.join(texts)!r}")
    return found


def require_speed_share_within_zero_to_one(speed: float) -> float:
    """Require a share of the greatest speed to lie within (0, 1].

    Raises RigError for anything else
    """
    if not 0 < speed <= 1:
        raise RigError(f"--speed takes a share above 0 and up to 1, got {speed:g}")
    return speed
