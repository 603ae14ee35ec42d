"""Loading of JSON, TOML and YAML files.

Into Entries with line and column of each value; and values as JSON data.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Json
from rig.errors import FileError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.local_and_remote_input_files import read_text, require_schema, short_repr
from rig.model.pose import pose_file_entry

_SPACE = re.compile(r"[ \t]*")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_STRING = re.compile(r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*\'''', re.DOTALL)
_SCALAR = re.compile(r"[^,\]}\s#]+(?: [0-9:.]+)?")


def toml_value_positions(text: str) -> dict[tuple[str | int, ...], tuple[int, int]]:
    """Positions of all values in a TOML text.

    A path is a tuple of keys and indices, as in ("camera", 0, "matrix", 2, 1); lines and columns count from 1.
    The path () stands for the start of the file.

    Returns {path: (line, column)}
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


LARGEST_INDEXED = 1 << 22  # characters of a text that is looked through; in a larger one nothing but the file is named
_JSON_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{},:]|[^\s\[\]{},:"]+', re.DOTALL)
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
            for path, at in _json_values(self._text):
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


def first_repeated_key_and_position(text: str) -> tuple[str, Place] | None:
    """The first repeated key of a JSON text with the position of its second value, or None."""
    seen = set()
    for path, at in _json_values(text):
        if path and path in seen:
            return str(path[-1]), (text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at))
        seen.add(path)
    return None


def dict_refusing_repeated_keys(key_value_pairs: list[tuple[str, object]]) -> Json:
    """Dict of JSON key-value pairs, refusing a repeated key (json's object_pairs_hook).

    Raises RepeatedKey for a key that occurs twice.
    """
    tree = dict(key_value_pairs)
    if len(tree) < len(key_value_pairs):
        raise RepeatedKey
    return tree


class RepeatedKey(ValueError):
    """A JSON text has a table with a key that occurs twice; see `first_repeated_key_and_position`."""


def _json_values(text: str) -> Iterator[tuple[KeyPath, int]]:
    """(path, offset) of every value, in the text's order; of a text that json accepts."""
    above: list[
        str | int | None
    ] = []  # keys and indices that lead to what is read; None where a table's key is still to come
    for token in _JSON_TOKEN.finditer(text):
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


LARGEST = 1 << 26  # bytes


def load_json(path: Path, file_kind: str, *schemas: str) -> Entries:
    """Load the Entries of a JSON file.

    file_kind : as in "calibration"; schemas : accepted ones, none for any.
    Raises FileError for a file that is missing, cut off, no JSON, nested too deep, of another schema, or with a key
        twice in one table
    """
    path = Path(path)
    text = read_text(path, LARGEST)
    try:
        tree = json.loads(text, object_pairs_hook=dict_refusing_repeated_keys)
    except RepeatedKey:
        key, place = (first_repeated_key_and_position(text) if len(text) <= LARGEST_INDEXED else None) or (
            "some key",
            (None, None),
        )
        raise FileError(path, f"key {short_repr(key)} occurs twice in one table: which applies?", *place, key) from None
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


def json_data(value: object) -> object:
    """JSON data of a value.

    Arrays and tuples as lists, dataclasses as tables of their fields, poses as entries.
    """
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, RigidTransform):
        return pose_file_entry(value)
    if is_dataclass(value):
        return {part.name: json_data(getattr(value, part.name)) for part in fields(value)}
    return [json_data(one) for one in value] if isinstance(value, tuple | list) else value


def nan_to_null(data: object) -> object:
    """The data with each NaN replaced by null, since JSON has no NaN."""
    if isinstance(data, dict):
        return {name: nan_to_null(value) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [nan_to_null(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def toml_entries(text: str, path: Path) -> Entries:
    """Unchecked Entries of a TOML file's text.
    path : of the file, for messages. Raises FileError where it is no TOML.
    """
    try:
        tree = tomllib.loads(text)
        places = toml_value_positions(text)
    except tomllib.TOMLDecodeError as error:
        where = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        line, column = map(int, where.groups()) if where else (len(text.splitlines()), None)
        raise FileError(path, f"not valid TOML: {str(error).split(' (at')[0]}", line, column) from None
    except RecursionError:
        raise FileError(path, "not valid TOML: nested too deep") from None
    except ValueError as error:  # a number of thousands of digits, a date that there is not
        raise FileError(path, f"not valid TOML: {error}") from None
    return Entries(tree, (), path, places)


LARGEST_YAML = 1 << 22  # bytes
MOST_YAML_VALUES = 100_000  # values: an alias may stand for many
DIRECTIVE = re.compile(r"\A%YAML[: ]1\.[0-9][^\n]*")  # as OpenCV writes it, which is no YAML
WHOLE = re.compile(r"[-+]?[0-9]{1,300}")
NUMBER = re.compile(r"[-+]?([0-9]{1,300}\.?[0-9]{0,300}|\.[0-9]{1,300})([eE][-+]?[0-9]{1,3})?")
WORDS = {
    "true": True,
    "false": False,
    "null": None,
    "~": None,
    "": None,
    ".inf": float("inf"),
    "-.inf": float("-inf"),
    ".nan": float("nan"),
}


def load_yaml(path: Path, list_key: str | None = None) -> Entries:
    """Load the Entries of a YAML file.

    list_key : under which a list in place of a table stands, None to refuse one
    Raises FileError for a file that is missing, cut off, no YAML, no table or larger than such files are.
    """
    text = DIRECTIVE.sub("", read_text(path, LARGEST_YAML))
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = (mark.line + 1, mark.column + 1) if mark else (None, None)
        raise FileError(path, f"not valid YAML: {error.problem or error.context} (cut off?)", *where) from None
    except yaml.YAMLError as error:
        raise FileError(path, f"not valid YAML: {str(error).splitlines()[0]}") from None
    except RecursionError:
        raise FileError(path, "not valid YAML: nested too deep") from None
    listed = list_key is not None and isinstance(root, yaml.SequenceNode)
    if root is None or not (listed or isinstance(root, yaml.MappingNode)):
        raise FileError(path, "holds no table of keys and values")
    places: dict[tuple[str | int, ...], tuple[int, int]] = {}
    try:
        tree = (
            {str(list_key): _yaml_value(root, (str(list_key),), places, path)}
            if listed
            else _yaml_value(root, (), places, path)
        )
    except RecursionError:
        raise FileError(path, "not valid YAML: nested too deep, or an alias within itself") from None
    assert isinstance(tree, dict)  # as its node is a mapping
    return Entries(tree, (), path, places)


def _yaml_value(
    node: yaml.Node, at: tuple[str | int, ...], places: dict[tuple[str | int, ...], tuple[int, int]], file: Path
) -> object:
    """A node as Python has it: tables, lists, texts, numbers, whatever tag it bears."""
    line, column = node.start_mark.line + 1, node.start_mark.column + 1
    places[at] = (line, column)
    if len(places) > MOST_YAML_VALUES:
        raise FileError(file, f"holds more than {MOST_YAML_VALUES} values", line, column)
    if isinstance(node, yaml.SequenceNode):
        return [_yaml_value(inner, (*at, i), places, file) for i, inner in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        tree: Json = {}
        for key, inner in node.value:
            if key.value in tree:
                raise FileError(
                    file, f"{key.value} occurs twice", key.start_mark.line + 1, key.start_mark.column + 1, key.value
                )
            tree[str(key.value)] = _yaml_value(inner, (*at, str(key.value)), places, file)
        return tree
    return node.value if getattr(node, "style", None) in ("'", '"') else _plain_yaml_word(node.value)


def _plain_yaml_word(text: str) -> object:
    """A bare word: a number as every other language reads it (1e-5 is one, 010 is ten), true, false, null or text."""
    if WHOLE.fullmatch(text):
        return int(text)
    return float(text) if NUMBER.fullmatch(text) else WORDS.get(text.lower(), text)
