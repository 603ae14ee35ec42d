"""JSON file of ours read into Entries with line and column of each value; repeated keys are errors."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import FileError
from rig.formats.input_files import read_text, require_schema, short_repr
from rig.formats.json_tree import Json

LARGEST_INDEXED = 1 << 22  # characters of a text that is looked through; in a larger one nothing but the file is named
_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{},:]|[^\s\[\]{},:"]+', re.DOTALL)
KeyPath = tuple[str | int, ...]
Place = tuple[int | None, int | None]


class Places(Mapping[KeyPath, Place]):
    """{path: (line, column)} of every value of a JSON text that json has accepted, looked for once it is asked for.
    text : JSON
    """

    def __init__(self, text: str) -> None:
        self._text = text

    @cached_property
    def _found(self) -> dict[KeyPath, Place]:
        found: dict[KeyPath, Place] = {(): (None, None)}
        if len(self._text) <= LARGEST_INDEXED:
            line, start, before = 1, 0, 0
            for path, at in _values(self._text):
                line += self._text.count("\n", before, at)
                start = self._text.rfind("\n", 0, at) + 1
                before = at
                if path:
                    found[path] = (line, at - start + 1)
        return found

    def __getitem__(self, path: KeyPath) -> Place:
        return self._found[path]

    def __iter__(self) -> Iterator[KeyPath]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


def first_repeated_key(text: str) -> tuple[str, Place] | None:
    """The first repeated key of a JSON text and the position of its second value, or None."""
    seen = set()
    for path, at in _values(text):
        if path and path in seen:
            return str(path[-1]), (text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at))
        seen.add(path)
    return None


def dict_without_repeated_keys(key_value_pairs: list[tuple[str, Any]]) -> Json:
    """Dict of JSON key-value pairs (json's object_pairs_hook). Raises RepeatedKey for repeated keys.
    Raises RepeatedKey for a key that is there twice.
    """
    tree = dict(key_value_pairs)
    if len(tree) < len(key_value_pairs):
        raise RepeatedKey
    return tree


class RepeatedKey(ValueError):
    """A JSON text has a table with a key that is there twice; see `first_repeated_key`."""


def _values(text: str) -> Iterator[tuple[KeyPath, int]]:
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


if TYPE_CHECKING:
    from rig.formats.checked_entries import Entries

LARGEST = 1 << 26  # bytes


def load(path: Path, file_kind: str, *schemas: str) -> Entries:
    """Load the Entries of a JSON file. file_kind : as in "calibration"; schemas : accepted ones, none for any.
    file_kind : it should be, as in "calibration"; schemas : of which it must name one; none for any.

    Raises FileError for a file that is missing, cut off, no JSON, nested too deep, of another schema, or with a key
        twice in one table
    """
    from rig.formats.checked_entries import Entries

    path = Path(path)
    text = read_text(path, LARGEST)
    try:
        tree = json.loads(text, object_pairs_hook=dict_without_repeated_keys)
    except RepeatedKey:
        key, place = (first_repeated_key(text) if len(text) <= LARGEST_INDEXED else None) or ("some key", (None, None))
        raise FileError(path, f"key {short_repr(key)} is there twice in one table: which holds?", *place, key) from None
    except json.JSONDecodeError as error:
        raise FileError(path, f"not valid JSON: {error.msg} (cut off?)", error.lineno, error.colno) from None
    except RecursionError:
        raise FileError(path, "not valid JSON: nested too deep") from None
    except ValueError as error:  # a number that is none, or of thousands of digits
        raise FileError(path, f"not valid JSON: {error}") from None
    if not isinstance(tree, dict):
        raise FileError(path, f"is no {file_kind}: it holds {short_repr(tree)}")
    places = Places(text)
    if schemas:
        require_schema(path, file_kind, tree.get("schema"), schemas, places.get(("schema",), (None, None)))
    return Entries(tree, (), path, places)


def nan_to_null(data: Any) -> Any:
    """The data with each NaN replaced by null, since JSON has no NaN."""
    if isinstance(data, dict):
        return {name: nan_to_null(value) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [nan_to_null(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
