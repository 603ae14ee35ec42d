"""Tables in YAML and MATLAB files, and table cells that hold arrays."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Booleans, Floats, Json
from rig.errors import FileError, RigError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.importers.foreign_table_column_search_and_completion import LONGEST, NUMBER, Cells
from rig.formats.importers.foreign_table_units_and_timestamps import header_name_and_unit
from rig.formats.json_toml_and_yaml_loading import load_yaml
from rig.formats.local_and_remote_input_files import read_bytes, short_repr
from rig.formats.numbers_and_units import ANGLES, LENGTHS

LONGEST_ARRAY = 2000  # characters of one cell
RIGID = 1e-3  # by which the rows of a rotation matrix may miss being orthonormal, as written with few digits
INNER = re.compile(r"\[([^\[\]]*)\]")
APART = re.compile(r"[\s,]+")
TURNS = ("rot", "orient", "quat", "euler", "rpy", "rvec", "richtung", "lage")  # of columns that hold rotations alone
PLACES = ("pose", "position", "transl", "where", "matrix", "transform", "tcp", "xyz", "lage", "punkt")
JOINTS = ("joint", "angle", "axis", "axes", "length", "leg", "strut", "theta", "command", "gelenk", "winkel", "achse")
VECTOR, QUATERNION = ("rx", "ry", "rz"), ("q0", "q1", "q2", "q3")
PLACE = ("x", "y", "z")
POSES = {3: PLACE, 6: (*PLACE, *VECTOR), 7: (*PLACE, *QUATERNION)}  # {numbers in a cell: what they are}
ALONE = {3: VECTOR, 4: QUATERNION}  # the same of rotations alone
MATRICES = {(4, 4), (3, 4), (3, 3)}


@dataclass(frozen=True, slots=True)
class ArrayCell:
    """values : texts of its numbers, row by row; shape : rows and columns, one row of a plain list"""

    values: tuple[str, ...]
    shape: tuple[int, int]


def is_array_cell(cell: str) -> bool:
    """Whether a cell's text is a list of numbers in brackets."""
    return cell.startswith("[") and cell.endswith("]") and len(cell) <= LONGEST_ARRAY


def cells_with_arrays_as_columns(cells: Cells, section: str) -> Cells:
    """Cells in which each column of arrays is replaced by a column for each number.

    As they are where there are none.
    section : "poses", where 3, 6 or 7 numbers are a position, rotation vector or quaternion and a matrix is a pose or
        a rotation; "commands", one number for each axis; others, numbered columns. By its name a column of joints is
        none of poses, and one of poses none of commands
    Raises FileError, with line and column, for what is no list of numbers, for lists of another length than the first,
    and for as many numbers as mean nothing there
    """
    arrays = [k for k in range(len(cells.header)) if any(is_array_cell(row[k]) for row in cells.rows)]
    if not arrays:
        return cells
    header: list[str] = []
    columns: list[list[str]] = []
    table, messages = cells.table, list(cells.remarks)
    for k, name in enumerate(cells.header):
        if k not in arrays:
            header.append(name)
            columns.append(cells.column(k))
            continue
        if (section == "poses" and _is_of_joints(name)) or (section == "commands" and _is_of_a_pose(name)):
            continue  # of the other table, where one file is both
        found = [_array(cells, row[k], line, k) for row, line in zip(cells.rows, cells.lines)]
        _require_one_shape(cells, found, k)
        shape = found[0].shape
        if section == "poses" and _is_matrix(shape):
            names, values = _of_matrices(cells, found, k)
            if table.rotation not in (None, "rotvec"):
                raise RigError(f"{cells.path}: {name} holds matrices, so poses.rotation={table.rotation} is not stated")
            table = replace(table, rotation="rotvec", rotation_unit="rad")
        else:
            names = _names(cells, name, section, shape, k)
            values = [list(one.values) for one in found]
        messages.append(f"{cells.path.name}: {name} holds {_in_words(shape)}: {', '.join(names)}")
        header += names
        columns += [list(column) for column in zip(*values)]
    twice = next((name for name in header if header.count(name) > 1), None)
    if twice is not None:
        raise FileError(cells.path, f"two columns are {twice}, one of a list of numbers in {_listed(cells, arrays)}")
    rows = [list(row) for row in zip(*columns)]
    return replace(cells, header=tuple(header), rows=rows, table=table, remarks=tuple(messages))


def _is_of_joints(name: str) -> bool:
    plain = header_name_and_unit(name)[0].lower()
    return plain in ("q", "l", "j") or any(word in plain for word in JOINTS)


def _is_of_a_pose(name: str) -> bool:
    plain = header_name_and_unit(name)[0].lower()
    return not _is_of_joints(name) and any(word in plain for word in (*TURNS, *PLACES))


def _listed(cells: Cells, columns: list[int]) -> str:
    return ", ".join(cells.header[k] for k in columns)


def _in_words(shape: tuple[int, int]) -> str:
    return f"{shape[1]} numbers" if shape[0] == 1 else f"matrices of {shape[0]} x {shape[1]}"


def _array(cells: Cells, cell: str, line: int, at: int) -> ArrayCell:
    def fail(what: str) -> NoReturn:
        name = short_repr(cells.header[at])
        raise FileError(cells.path, f"column {name} {what}: {short_repr(cell)}", line, at + 1, cell)

    if not is_array_cell(cell):
        fail("holds lists of numbers, and here none")
    inner = INNER.findall(cell)
    rest = INNER.sub("", cell[1:-1]) if len(inner) > 1 or cell.startswith("[[") else ""
    if re.sub(r"[\s,;]", "", rest):
        fail("is not a list of numbers")
    parts = inner if rest or len(inner) > 1 else inner[0].split(";")
    rows = [[word for word in APART.split(part.strip()) if word] for part in parts]
    for word in (word for row in rows for word in row):
        if len(word) > LONGEST or not NUMBER["point"].fullmatch(word):
            fail(f"is not a list of numbers, as of {short_repr(word)}")
    if not rows[0] or len({len(row) for row in rows}) > 1:
        fail("has rows of different lengths")
    return ArrayCell(tuple(word for row in rows for word in row), (len(rows), len(rows[0])))


def _require_one_shape(cells: Cells, found: list[ArrayCell], at: int) -> None:
    for one, line in zip(found, cells.lines):
        if one.shape != found[0].shape:
            name = short_repr(cells.header[at])
            raise FileError(
                cells.path,
                f"column {name} holds {_in_words(one.shape)}, and {_in_words(found[0].shape)} in line {cells.lines[0]}",
                line,
                at + 1,
            )


def _is_matrix(shape: tuple[int, int]) -> bool:
    return shape in MATRICES or shape in ((1, 16), (1, 9), (1, 12))


def _names(cells: Cells, name: str, section: str, shape: tuple[int, int], at: int) -> list[str]:
    """Names of the columns that the numbers of a plain list become, with the unit that its header states."""
    plain, unit = header_name_and_unit(name)
    count = shape[0] * shape[1]
    given = "" if unit is None else f" [{unit}]"
    if section == "commands" and 1 in shape:
        return [f"axis{i + 1}{given}" for i in range(count)]
    if section != "poses" and 1 in shape:
        return [f"{plain}_{i + 1}{given}" for i in range(count)]
    turns = any(word in plain.lower() for word in TURNS)
    names = (ALONE if turns else POSES).get(count) if 1 in shape else None
    if names is None:
        known = "3 or 4 numbers or a 3x3 matrix" if turns else "3, 6 or 7 numbers or a 4x4 matrix"
        raise FileError(
            cells.path,
            f"column {short_repr(name)} holds {_in_words(shape)}; a {'rotation' if turns else 'pose'} is {known}",
            cells.lines[0],
            at + 1,
        )
    if names == VECTOR and "rpy" in plain.lower():
        names = ("roll", "pitch", "yaw")
    of_unit = {**dict.fromkeys(PLACE, LENGTHS), **dict.fromkeys((*VECTOR, "roll", "pitch", "yaw"), ANGLES)}
    return [one + (given if unit in of_unit.get(one, {}) else "") for one in names]


def _of_matrices(cells: Cells, found: list[ArrayCell], at: int) -> tuple[list[str], list[list[str]]]:
    """(names, rows of texts) of a column of matrices: positions as written, rotations as vectors in rad."""
    count = len(found[0].values)
    texts = np.array([one.values for one in found])
    values = texts.astype(float)
    square = {16: (4, 4), 12: (3, 4), 9: (3, 3)}[count]
    M, words = values.reshape(-1, *square), texts.reshape(-1, *square)
    if square == (4, 4) and not _ends(M) and _ends(np.swapaxes(M, 1, 2)):  # written column by column
        M, words = np.swapaxes(M, 1, 2), np.swapaxes(words, 1, 2)
    if square == (4, 4):
        _require(cells, at, np.abs(M[:, 3] - [0, 0, 0, 1]).max(axis=1) < RIGID)
    R = M[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    _require(cells, at, (off < RIGID) & (np.linalg.det(R) > 0))
    turns = [[f"{x:.17g}" for x in row] for row in Rotation.from_matrix(R).as_rotvec()]
    if square == (3, 3):
        return list(VECTOR), turns
    _, unit = header_name_and_unit(cells.header[at])
    given = f" [{unit}]" if unit in LENGTHS else ""
    places = words[:, :3, 3].tolist()
    return [*(f"{one}{given}" for one in PLACE), *VECTOR], [[*p, *turn] for p, turn in zip(places, turns)]


def _ends(M: Floats) -> bool:
    return bool(np.abs(M[:, 3] - [0, 0, 0, 1]).max() < RIGID)


def _require(cells: Cells, at: int, sound: Booleans) -> None:
    """Raise FileError at the first row (n,) whose matrix is no rotation, or no pose."""
    if sound.all():
        return
    k = int(np.flatnonzero(~sound)[0])
    name, cell = short_repr(cells.header[at]), cells.rows[k][at]
    what = "is no pose: a matrix of three orthonormal rows, right-handed, and at most a last row 0 0 0 1"
    raise FileError(cells.path, f"column {name} {what}: {short_repr(cell)}", cells.lines[k], at + 1, cell)


MatlabValues = NDArray[np.generic]  # numbers, words or cells of any
ROWS = ""  # key of a list that is the whole file
LARGEST = 1 << 27  # bytes
TURN_KEYS = ("orientation", "rotation", "quaternion")  # of tables with x, y, z and w
PLACE_KEYS = ("position", "translation")
SAVED = "save('FILE.mat', '-v7', ..)"


@dataclass(frozen=True, slots=True)
class FileRows:
    """header : n names; rows : of n texts, arrays in brackets; lines : of the file, or numbers of rows, from 1;
    remarks : sentences on what was read
    """

    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    remarks: tuple[str, ...] = ()


def is_yaml(path: Path) -> bool:
    """Whether a file is YAML, by its name."""
    return path.suffix.lower() in (".yaml", ".yml")


def is_matlab(path: Path) -> bool:
    """Whether a file is one of MATLAB's by its name."""
    return path.suffix.lower() == ".mat"


def read_yaml_rows(path: Path, section: str) -> FileRows:
    """Read the rows (FileRows) of a YAML file.

    It has a list of tables, or tables of lists that are equally long.
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
            named = key if word in PLACE_KEYS else f"q{key}" if word in TURN_KEYS and "w" in value else f"{name}.{key}"
            out[key if word in ("pose", "transform") else named] = inner
    return out


def _text(value: object) -> str:
    return json.dumps(value) if isinstance(value, list) else str(value)


def read_matlab_rows(path: Path) -> FileRows:
    """Read the rows (FileRows) of a MATLAB file.

    A .mat file of version 7 or earlier: variables, or the fields of one structure, with a row each.
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
    retained = {name: column for name, column in columns.items() if column is not None}
    others = [f"{name} ({' x '.join(map(str, arrays[name].shape))})" for name in columns if name not in retained]
    if len(retained) < 2 and (not retained or len(arrays) > 1):
        raise FileError(path, f"has no variables with as many rows as each other: {', '.join(others)}")
    message = () if not others else (f"{path.name}: left out, as they do not have {count} rows: {', '.join(others)}",)
    return FileRows(tuple(retained), [list(row) for row in zip(*retained.values())], list(range(1, count + 1)), message)


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
