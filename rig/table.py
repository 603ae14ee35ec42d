"""A CSV file of outside data -> checked columns; every complaint names file, line and column."""

import csv
import difflib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.origin import LATEST, Origin, other_unit
from rig.errors import FileError

LONGEST_NUMBER = 100  # characters; a float has 17 digits


@dataclass(frozen=True, slots=True)
class Table:
    """path; columns: header names in file order; rows: lists of text; lines: (n,) file line of each row, from 1."""

    path: Path
    columns: tuple[str, ...]
    rows: list
    lines: np.ndarray

    def __len__(self):
        return len(self.rows)

    def fail(self, message, row, column=None, value=None):
        """Raise FileError at a row (index) and a column (name); the column is given as its place in the row, from 1."""
        place = self.columns.index(column) + 1 if column is not None else None
        raise FileError(self.path, message, int(self.lines[row]), place, value)

    def text(self, column):
        """List of the column's cells, spaces around them dropped."""
        at = self.columns.index(column)
        return [row[at].strip() for row in self.rows]

    def numbers(self, column):
        """(n,) finite floats. Raises FileError at the first cell that is none."""
        cells = self.text(column)
        try:
            values = np.array(cells, float) if cells else np.zeros(0)
            if np.isfinite(values).all():
                return values
        except ValueError:
            pass
        for i, cell in enumerate(cells):
            try:
                bad = "" if np.isfinite(float(cell)) else "is not finite"
            except ValueError:
                bad = "is not a number" if cell else "is empty"
            if bad:
                self.fail(f"column {column!r} {bad}: {cell!r}", i, column, cell)
        raise AssertionError("unreachable: a bad column without a bad cell")

    def times(self, column, origin: Origin):
        """(n,) s from a recording's start. Raises FileError at the first cell that is no finite number or cannot be in seconds."""
        values, cells = self.numbers(column), self.text(column)
        far = np.flatnonzero(np.abs(values) > LATEST)
        if len(far):
            i = far[0]
            self.fail(f"column {column!r} is in seconds, and {cells[i]} s is later than any clock shows: is it in {other_unit(values[i])}?", i,
                      column, cells[i])
        return origin.seconds(cells)

    def whole(self, column):
        """(n,) integers of at least 0. Raises FileError at the first cell that is none."""
        values = self.numbers(column)
        bad = np.flatnonzero((values != np.round(values)) | (values < 0))
        if len(bad):
            self.fail(f"column {column!r} must be a whole number of at least 0, not {self.text(column)[bad[0]]!r}", bad[0], column)
        return values.astype(int)

    def matrix(self, columns):
        """(n, k) finite floats of several columns."""
        return np.stack([self.numbers(column) for column in columns], axis=1) if columns else np.zeros((len(self), 0))


def read(path, required, optional=()):
    """Table of a CSV file with a header line.

    required : column names that must be there; optional : names that may be. Further columns are kept, unless one looks
    like a slip of a known name.
    Raises FileError: no file, no header, a column missing, twice given or misspelt, a row of another length, no rows.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read as text: {error}") from None
    reader = csv.reader(text.splitlines())
    header = tuple(name.strip() for name in next(reader, ()))
    if not any(header):
        raise FileError(path, f"is empty; its first line must name the columns {','.join(required)}", 1)
    for place, name in enumerate(header, 1):
        if header.index(name) + 1 != place:
            raise FileError(path, f"column {name!r} is given twice", 1, place, name)
    missing = [name for name in required if name not in header]
    if missing:
        raise FileError(path, f"column {missing[0]!r} is missing; the header is {','.join(header)!r}", 1)
    absent = [name for name in optional if name not in header and len(name) > 2]
    for place, name in enumerate(header, 1):
        near = difflib.get_close_matches(name, absent, n=1, cutoff=0.8) if name not in (*required, *optional) else ()
        if near:
            raise FileError(path, f"unknown column {name!r}; is {near[0]!r} meant?", 1, place, name)
    rows, lines = [], []
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise FileError(path, f"{len(row)} cells in a table of {len(header)} columns", reader.line_num,
                            min(len(row), len(header)) or None)
        rows.append(row)
        lines.append(reader.line_num)
    if not rows:
        raise FileError(path, "has a header but no rows", 1)
    return Table(path, header, rows, np.array(lines))
