"""Tables in YAML files and MATLAB's .mat files, as header and rows of texts."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.array_and_json_types import Json
from rig.errors import FileError
from rig.formats.checked_entries import Entries
from rig.formats.json_toml_and_yaml_loading import load_yaml
from rig.formats.local_and_remote_input_files import read_bytes, short_repr

MatlabValues = NDArray[np.generic]  # numbers, words or cells of any
ROWS = ""  # key of a list that is the whole file
LARGEST = 1 << 27  # bytes
QUATERNION = ("orientation", "rotation", "quaternion")  # of tables with x, y, z and w
PLACE = ("position", "translation")
SAVED = "save('FILE.mat', '-v7', ..)"


@dataclass(frozen=True, slots=True)
class FileRows:
    """header : n names; rows : of n texts, arrays in brackets; lines : of the file, or numbers of rows, from 1;
    said : sentences on what was read
    """

    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    said: tuple[str, ...] = ()


def is_yaml(path: Path) -> bool:
    """Whether a file is YAML by its name."""
    return path.suffix.lower() in (".yaml", ".yml")


def is_matlab(path: Path) -> bool:
    """Whether a file is one of MATLAB's by its name."""
    return path.suffix.lower() == ".mat"


def read_yaml_rows(path: Path, section: str) -> FileRows:
    """FileRows of a YAML file: a list of tables, or tables of lists that are equally long.

    section : key of the list that is meant, where a file has several
    Raises FileError, with the line, for what is neither, and for a row that lacks a key or has another
    """
    root = load_yaml(path, ROWS)
    lists = [key for key, value in root.tree.items() if _is_table_list(value)]
    if len(lists) > 1 and section in lists:
        lists = [section]
    if len(lists) == 1:
        return _rows_of_tables(root, lists[0])
    if len(lists) > 1:
        root.fail(f"has several lists of tables, {', '.join(lists)}; name the one that is meant {section}", lists[1])
    return _rows_of_lists(root)


def _is_table_list(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(one, dict) for one in value)


def _rows_of_tables(root: Entries, key: str) -> FileRows:
    rows = [_flat(one) for one in root.tree[key]]
    header, lines = tuple(rows[0]), [root.places[key, k][0] or 0 for k in range(len(rows))]
    for k, row in enumerate(rows):
        for name in (*(name for name in header if name not in row), *(name for name in row if name not in header)):
            what = f"lacks {name}, which the first row has" if name in header else f"has {name}, which the first lacks"
            root.fail(f"row {k + 1} {what}", key, k)
    return FileRows(header, [[_text(row[name]) for name in header] for row in rows], lines)


def _rows_of_lists(root: Entries) -> FileRows:
    tree = _flat(root.tree)
    columns = {name: value for name, value in tree.items() if isinstance(value, list)}
    if not columns:
        root.fail("holds no table: a list of rows, each with its keys, or keys with equally long lists", *root.tree)
    count = len(next(iter(columns.values())))
    for name, value in columns.items():
        if len(value) != count:
            root.fail(f"{name} has {len(value)} rows and {next(iter(columns))} {count}", name.split(".")[0])
    places = [root.places.get((next(iter(columns)), k), (1, 1))[0] or 1 for k in range(count)]
    rows = [[_text(value[k]) for value in columns.values()] for k in range(count)]
    return FileRows(tuple(columns), rows, places)


def _flat(table: Json) -> Json:
    """A table whose tables within it are columns of their own: of a position x, y, z; of an orientation qx .. qw."""
    out: Json = {}
    for name, value in table.items():
        if not isinstance(value, dict):
            out[name] = value
            continue
        word = name.lower()
        for key, inner in _flat(value).items():
            named = key if word in PLACE else f"q{key}" if word in QUATERNION and "w" in value else f"{name}.{key}"
            out[key if word in ("pose", "transform") else named] = inner
    return out


def _text(value: object) -> str:
    return json.dumps(value) if isinstance(value, list) else str(value)


def read_matlab_rows(path: Path) -> FileRows:
    """FileRows of a .mat file of version 7 or earlier: variables, or the fields of one structure, with a row each.

    A variable of n rows is a column, of n rows and k columns a column of lists, of 4 x 4 x n a column of matrices.
    Raises FileError for version 7.3, for what MATLAB alone can read, and for variables without rows in common
    """
    from scipy.io import loadmat, matlab

    data = read_bytes(path, LARGEST)
    if data[:128].startswith(b"MATLAB 7.3") or data[512:520] == b"\x89HDF\r\n\x1a\n":
        raise FileError(path, f"is a file of MATLAB 7.3, which is HDF5: save it with {SAVED}")
    try:
        found = loadmat(BytesIO(data), simplify_cells=True)
    except (matlab.MatReadError, ValueError, TypeError, NotImplementedError, KeyError, EOFError, OSError) as error:
        raise FileError(path, f"is not a readable .mat file (cut off?): {str(error).splitlines()[0]}") from None
    found = {name: value for name, value in found.items() if not name.startswith("__")}
    only = next(iter(found.values())) if len(found) == 1 else None
    if isinstance(only, dict):
        found = only
    elif isinstance(only, list | np.ndarray) and len(only) and all(isinstance(one, dict) for one in only):
        found = _fields_of_structures(path, list(only))
    arrays = {name: np.asarray(value) for name, value in found.items() if not isinstance(value, dict)}
    arrays = {name: array for name, array in arrays.items() if array.size > 1 and array.ndim <= 3}
    opaque = [name for name, array in arrays.items() if array.dtype.names is not None]
    if opaque or "None" in found or not arrays:
        what = f"{opaque[0]!r} is an object" if opaque else "holds no variable with rows"
        raise FileError(path, f"{what} of MATLAB's own; convert a table with table2struct(T, 'ToScalar', true)")
    count = _row_count(arrays)
    columns = {name: _column(array, count) for name, array in arrays.items()}
    kept = {name: column for name, column in columns.items() if column is not None}
    others = [f"{name} ({' x '.join(map(str, arrays[name].shape))})" for name in columns if name not in kept]
    if len(kept) < 2 and (not kept or len(arrays) > 1):
        raise FileError(path, f"has no variables with as many rows as each other: {', '.join(others)}")
    said = () if not others else (f"{path.name}: left out, as they do not have {count} rows: {', '.join(others)}",)
    return FileRows(tuple(kept), [list(row) for row in zip(*kept.values())], list(range(1, count + 1)), said)


def _fields_of_structures(path: Path, structures: Sequence[Json]) -> Json:
    """{field: values of all rows} of an array of structures, one for each row; of matrices with the rows last."""
    out: Json = {}
    for name in structures[0]:
        try:
            stack = np.array([one[name] for one in structures])
        except (ValueError, KeyError):
            raise FileError(path, f"field {name!r} is not alike in all {len(structures)} structures") from None
        out[name] = np.moveaxis(stack, 0, -1) if stack.ndim == 3 else stack
    return out


def _row_count(arrays: dict[str, MatlabValues]) -> int:
    """How many rows most variables have: of lists their length, of stacks of matrices their last size."""
    sizes = [array.shape[-1] if array.ndim != 2 else max(array.shape) for array in arrays.values()]
    return max(sizes, key=lambda size: (sizes.count(size), size))


def _column(array: MatlabValues, count: int) -> list[str] | None:
    """Texts of a variable's rows, None where it does not have as many."""
    if array.ndim == 3:
        rows = np.moveaxis(array, -1, 0)
    elif array.ndim == 2 and array.shape[0] != count:
        rows = array.T
    else:
        rows = array
    if len(rows) != count:
        return None
    return [_text(row.tolist() if isinstance(row, np.ndarray) else _plain(row)) for row in rows]


def _plain(value: object) -> object:
    return value.item() if isinstance(value, np.generic) else short_repr(value) if not isinstance(value, str) else value
