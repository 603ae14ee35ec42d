"""Positions (line and column) of the values in a TOML text, for error messages."""

import re
import tomllib
from collections.abc import Callable, Sequence

_SPACE = re.compile(r"[ \t]*")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_STRING = re.compile(r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*\'''', re.DOTALL)
_SCALAR = re.compile(r"[^,\]}\s#]+(?: [0-9:.]+)?")


def value_positions(text: str) -> dict[tuple[str | int, ...], tuple[int, int]]:
    """Positions of all values in a TOML text: {path: (line, column)}.

    A path is a tuple of keys and indices, as in ("camera", 0, "matrix", 2, 1); lines and columns count from 1.
    The path () stands for the start of the file.
    """
    scanner = _Scanner(text)
    scanner.document()
    starts = [0] + [match.end() for match in re.finditer("\n", text)]
    found: dict[tuple[str | int, ...], tuple[int, int]] = {(): (1, 1)}
    line = 0
    for path, at in sorted(scanner.found.items(), key=lambda item: item[1]):
        while line + 1 < len(starts) and starts[line + 1] <= at:
            line += 1
        found[path] = (line + 1, at - starts[line] + 1)
    return found


def _name(key: str) -> str:
    """The name that a key denotes, quoted or bare."""
    if "\\" in key and key[0] == '"':
        name: str = tomllib.loads(f"name = {key}")["name"]
        return name
    return key.strip("\"'")


class _Scanner:
    """A recursive descent over TOML that records only offsets."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.found: dict[tuple[str | int, ...], int] = {}
        self.counts: dict[tuple[str | int, ...], int] = {}

    def skip(self, pattern: re.Pattern[str]) -> None:
        self.at = self.match(pattern).end()

    def match(self, pattern: re.Pattern[str]) -> re.Match[str]:
        found = pattern.match(self.text, self.at)
        if found is None:
            raise ValueError(f"no TOML at {self.at}")
        return found

    def key(self) -> tuple[str, ...]:
        parts = []
        while True:
            self.skip(_SPACE)
            match = self.match(_KEY)
            parts.append(_name(match.group()))
            self.at = match.end()
            self.skip(_SPACE)
            if self.text[self.at] != ".":
                return tuple(parts)
            self.at += 1

    def resolve(self, parts: Sequence[str]) -> tuple[str | int, ...]:
        """Insert the index of the latest element wherever a part names an array of tables."""
        path: tuple[str | int, ...] = ()
        for part in parts:
            path += (part,)
            if path in self.counts:
                path += (self.counts[path] - 1,)
        return path

    def document(self) -> None:
        base: tuple[str | int, ...] = ()
        while True:
            self.skip(_BLANK)
            if self.at >= len(self.text):
                return
            start = self.at
            if self.text.startswith("[[", self.at):
                self.at += 2
                *above, last = self.key()
                array = self.resolve(above) + (last,)
                self.counts[array] = self.counts.get(array, 0) + 1
                base = array + (self.counts[array] - 1,)
                self.at += 2
            elif self.text[self.at] == "[":
                self.at += 1
                base = self.resolve(self.key())
                self.at += 1
            else:
                self.pair(base)
                continue
            self.found.setdefault(base, start)

    def pair(self, base: tuple[str | int, ...]) -> None:
        path = base + self.key()
        self.at += 1  # the equals sign
        self.skip(_SPACE)
        self.value(path)

    def value(self, path: tuple[str | int, ...]) -> None:
        self.found[path] = self.at
        opening = self.text[self.at]
        if opening == "[":
            self.items(path, "]", lambda index: self.value(path + (index,)))
        elif opening == "{":
            self.items(path, "}", lambda index: self.pair(path))
        else:
            pattern = _STRING if opening in "\"'" else _SCALAR
            self.skip(pattern)

    def items(self, path: tuple[str | int, ...], closing: str, read: Callable[[int], None]) -> None:
        self.at += 1
        index = 0
        while True:
            self.skip(_BLANK)
            if self.text[self.at] == closing:
                self.at += 1
                return
            if self.text[self.at] == ",":
                self.at += 1
                continue
            read(index)
            index += 1
