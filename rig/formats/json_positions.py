"""Where each value of a JSON text stands, so that an error can name line and column (json does not say), and which key
is there twice.
"""

import json
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

LARGEST = 1 << 22  # characters of a text that is looked through; in a larger one nothing but the file is named
_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{},:]|[^\s\[\]{},:"]+', re.DOTALL)
Path = tuple[str | int, ...]
Place = tuple[int | None, int | None]


class Places(Mapping[Path, Place]):
    """{path: (line, column)} of every value of a JSON text that json has accepted, looked for once it is asked for.
    text : JSON
    """

    def __init__(self, text: str) -> None:
        self._text = text

    @cached_property
    def _found(self) -> dict[Path, Place]:
        found: dict[Path, Place] = {(): (None, None)}
        if len(self._text) <= LARGEST:
            line, start, before = 1, 0, 0
            for path, at in _values(self._text):
                line += self._text.count("\n", before, at)
                start = self._text.rfind("\n", 0, at) + 1
                before = at
                if path:
                    found[path] = (line, at - start + 1)
        return found

    def __getitem__(self, path: Path) -> Place:
        return self._found[path]

    def __iter__(self) -> Iterator[Path]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


def repeated_key(text: str) -> tuple[str, Place] | None:
    """(key, place of its second value) of the first key that a table of a JSON text has twice, or None."""
    seen = set()
    for path, at in _values(text):
        if path and path in seen:
            return str(path[-1]), (text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at))
        seen.add(path)
    return None


def pairs(found: list[tuple[str, Any]]) -> dict[str, Any]:
    """A table of a JSON text, for json's object_pairs_hook. Raises RepeatedKey for a key that is there twice."""
    tree = dict(found)
    if len(tree) < len(found):
        raise RepeatedKey
    return tree


class RepeatedKey(ValueError):
    """A JSON text has a table with a key that is there twice; see `repeated_key`."""


def _values(text: str) -> Iterator[tuple[Path, int]]:
    """(path, offset) of every value, in the text's order; of a text that json accepts."""
    above: list[
        str | int | None
    ] = []  # keys and indices that lead to what is read; None where a table's key is still to come
    for token in _TOKEN.finditer(text):
        word = token.group()
        if word in "]}":
            above.pop()
        elif word == ",":
            above[-1] = above[-1] + 1 if isinstance(above[-1], int) else None
        elif word == ":":
            continue
        elif above and above[-1] is None:
            above[-1] = str(json.loads(word))
        else:
            yield tuple(part for part in above if part is not None), token.start()
            if word in "[{":
                above.append(0 if word == "[" else None)
