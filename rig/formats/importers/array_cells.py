"""Cells of a foreign table that hold several numbers: a pose, a 4x4 matrix, all joints; each number becomes a cell."""

import re
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Booleans, Floats
from rig.errors import FileError, RigError
from rig.formats.importers.foreign_table_columns import LONGEST, NUMBER, Cells
from rig.formats.importers.units_and_timestamps import split_header
from rig.formats.length_and_angle_units import ANGLES, LENGTHS
from rig.formats.local_and_remote_input_files import short_repr

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
    """Cells whose columns of arrays are a column for each number; as they are where there are none.

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
    table, said = cells.table, list(cells.said)
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
        said.append(f"{cells.path.name}: {name} holds {_in_words(shape)}: {', '.join(names)}")
        header += names
        columns += [list(column) for column in zip(*values)]
    twice = next((name for name in header if header.count(name) > 1), None)
    if twice is not None:
        raise FileError(cells.path, f"two columns are {twice}, one of a list of numbers in {_listed(cells, arrays)}")
    rows = [list(row) for row in zip(*columns)]
    return replace(cells, header=tuple(header), rows=rows, table=table, said=tuple(said))


def _is_of_joints(name: str) -> bool:
    plain = split_header(name)[0].lower()
    return plain in ("q", "l", "j") or any(word in plain for word in JOINTS)


def _is_of_a_pose(name: str) -> bool:
    plain = split_header(name)[0].lower()
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
    plain, unit = split_header(name)
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
    _, unit = split_header(cells.header[at])
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
