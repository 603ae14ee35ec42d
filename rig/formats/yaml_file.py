"""YAML file of other programs read into Entries; errors name file, line and column."""

import re
from pathlib import Path
from typing import Any

import yaml

from rig.errors import FileError
from rig.formats.checked_entries import Entries
from rig.formats.input_files import read_text
from rig.formats.json_tree import Json

LARGEST = 1 << 22  # bytes
MOST = 100_000  # values: an alias may stand for many
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


def load(path: Path) -> Entries:
    """Load the Entries of a YAML file. Raises FileError.
    Raises FileError for a file that is missing, cut off, no YAML, no table or larger than such files are.
    """
    text = DIRECTIVE.sub("", read_text(path, LARGEST))
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
    if not isinstance(root, yaml.MappingNode):
        raise FileError(path, "holds no table of keys and values")
    places: dict[tuple[str | int, ...], tuple[int, int]] = {}
    try:
        tree = _value(root, (), places, path)
    except RecursionError:
        raise FileError(path, "not valid YAML: nested too deep, or an alias within itself") from None
    return Entries(tree, (), path, places)


def _value(
    node: yaml.Node, at: tuple[str | int, ...], places: dict[tuple[str | int, ...], tuple[int, int]], file: Path
) -> Any:
    """A node as Python has it: tables, lists, texts, numbers, whatever tag it bears."""
    line, column = node.start_mark.line + 1, node.start_mark.column + 1
    places[at] = (line, column)
    if len(places) > MOST:
        raise FileError(file, f"holds more than {MOST} values", line, column)
    if isinstance(node, yaml.SequenceNode):
        return [_value(inner, (*at, i), places, file) for i, inner in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        tree: Json = {}
        for key, inner in node.value:
            if key.value in tree:
                raise FileError(
                    file, f"{key.value} is there twice", key.start_mark.line + 1, key.start_mark.column + 1, key.value
                )
            tree[str(key.value)] = _value(inner, (*at, str(key.value)), places, file)
        return tree
    return node.value if getattr(node, "style", None) in ("'", '"') else _plain(node.value)


def _plain(text: str) -> Any:
    """A bare word: a number as every other language reads it (1e-5 is one, 010 is ten), true, false, null or text."""
    if WHOLE.fullmatch(text):
        return int(text)
    return float(text) if NUMBER.fullmatch(text) else WORDS.get(text.lower(), text)
