"""Argument parser of the commands.

With the nearest known word for a mistyped option or command, and completion scripts of shells.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, _SubParsersAction
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from _typeshed import SupportsWrite


INVALID = re.compile(r"invalid parse_(\w+) value")  # as argparse names what parses an argument
NEGATIVE = re.compile(r"-\.?\d[^,]*,")  # figures separated by commas, of which the first is negative


def join_negative_numbers(words: Iterable[str]) -> list[str]:
    """Join options with negative numbers.

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
    near = nearest_word(word, known)
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
