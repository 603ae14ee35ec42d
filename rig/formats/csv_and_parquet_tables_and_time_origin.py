"""CSV and Parquet tables, and the time origin.

Tables are read and written; the origin is that of a recording.

Errors with line and column; the owner's clock to seconds from the start, and back, without rounding.
A clock that counts from 1970 stands at 1.7e9 s, where a float resolves 2.4e-7 s; the start is therefore taken off in
decimal, before a time becomes a float, and put back in decimal when one is written.
"""

import csv
import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.errors import FileError, MissingLibrary
from rig.formats.checked_toml_and_json_entries import LARGEST_NUMBER, LARGEST_WHOLE
from rig.formats.local_and_remote_input_files import open_regular_file, read_text, short_repr
from rig.formats.numbers_and_units import (
    LONGEST_NUMBER,
    SI,
    LengthAndAngleUnits,
    NotFinite,
    parse_number,
    parse_numbers,
)

DIGITS = Context(prec=60, traps=[])
LATEST = 1e11  # s, in the year 5138; a greater figure is in another unit
UNITS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))


@dataclass(frozen=True, slots=True)
class TimeOrigin:
    """offset : s, what the owner's clock shows at the recording's start, t = 0."""

    offset: Decimal = Decimal(0)

    def seconds(self, texts: list[str]) -> Floats:
        """(n,) s from the recording's start, of n times as the owner's clock shows them: texts that are finite
        numbers.
        """
        if not self.offset:
            return np.array(texts, float)
        return np.array([float(DIGITS.subtract(parse_exact_decimal(text), self.offset)) for text in texts], float)

    def text(self, t: float) -> str:
        """A time t (s from the recording's start) as the owner's clock shows it, with all the digits that it had."""
        return f"{DIGITS.add(self.offset, Decimal(repr(float(t)))):f}"

    def shown(self, t: float) -> float:
        """The same as a number."""
        return float(self.text(t)) if self.offset else float(t)


def parse_exact_decimal(text: str) -> Decimal:
    """Exact Decimal of a finite number's text."""
    try:
        return Decimal(text)
    except InvalidOperation:  # an exponent beyond what decimals hold: nothing, as for a float
        return Decimal(float(text))


def likely_time_unit(t: float) -> str:
    """Likely unit, as text, of a time that is too large for seconds."""
    return next((name for name, scale in UNITS if abs(t) / scale < LATEST / 10), UNITS[-1][0])


FOREIGN = {"semicolon": ";", "tab": "\t"}  # separators of other people's tables
MOST_COLUMNS = 1000


@dataclass(frozen=True, slots=True)
class TableFormat:
    """How a table writes figures. units : of lengths and angles; decimal : "point", commas between the cells, or
    "comma", semicolons between them
    """

    units: LengthAndAngleUnits = SI
    decimal: str = "point"

    def __post_init__(self) -> None:
        if self.decimal not in SEPARATORS:
            raise ValueError(f"decimal takes {', '.join(SEPARATORS)}, got {self.decimal!r}")

    def line(self, cells: Iterable[str]) -> str:
        """A line of cells, which have decimal points."""
        text = SEPARATORS[self.decimal].join(cells)
        return text.replace(".", ",") if self.decimal == "comma" else text

    def figures(self, values: Floats, units: Sequence[str]) -> list[list[str]]:
        """Texts of values (n, k) in SI units, resolved to 1e-10 m and rad. units : k SI units"""
        per = np.array([self.units.per_si(unit) for unit in units])
        digits = np.maximum(10 - np.floor(np.log10(per)).astype(int), 4)
        return [[f"{v:.{d}f}" for v, d in zip(row, digits)] for row in (np.asarray(values) * per).tolist()]


SEPARATORS = {"point": ",", "comma": ";"}  # between the cells of a table with these decimal signs
PLAIN = TableFormat()


@dataclass(frozen=True, slots=True)
class Table:
    """path; columns: header names in file order; rows: lists of text, decimals with a point; lines: (n,) file line of
    each row, from 1; form : of the file
    """

    path: Path
    columns: tuple[str, ...]
    rows: list[list[str]]
    lines: Floats
    form: TableFormat = PLAIN

    def __len__(self) -> int:
        return len(self.rows)

    def fail(self, message: str, row: int | np.integer, column: str | None = None, value: object = None) -> NoReturn:
        """Raise FileError at a row (index) and a column (name); the column is given as its place in the row, from 1."""
        place = self.columns.index(column) + 1 if column is not None else None
        raise FileError(self.path, message, int(self.lines[row]), place, value)

    def text(self, column: str) -> list[str]:
        """List of the column's cells, spaces around them dropped."""
        at = self.columns.index(column)
        return [row[at].strip(" \t") for row in self.rows]

    def numbers(self, column: str) -> Floats:
        """(n,) finite floats. Raises FileError at the first cell that is none."""
        cells = self.text(column)
        try:
            values = np.array(parse_numbers(cells))
            if (np.abs(values) <= LARGEST_NUMBER).all():
                return values
        except ValueError:
            pass
        for i, cell in enumerate(cells):
            problem = _number_problem(cell)
            if problem:
                self.fail(f"column {short_repr(column)} {problem}: {short_repr(cell)}", i, column, cell)
        raise AssertionError("unreachable: a bad column without a bad cell")

    def times(self, column: str, origin: TimeOrigin) -> Floats:
        """(n,) s from a recording's start. Raises FileError at the first cell that is no finite number or cannot be in
        seconds.
        """
        values, cells = self.numbers(column), self.text(column)
        far = np.flatnonzero(np.abs(values) > LATEST)
        if len(far):
            i = far[0]
            self.fail(
                f"column {column!r} is in seconds, and {cells[i]} s is later than any clock shows: is it in "
                f"{likely_time_unit(values[i])}?",
                i,
                column,
                cells[i],
            )
        return origin.seconds(cells)

    def first_time_origin(self) -> TimeOrigin:
        """The TimeOrigin that stands at 0 at the first row's t. Raises FileError as `times` does."""
        self.times("t", TimeOrigin())
        return TimeOrigin(parse_exact_decimal(self.text("t")[0]))

    def increasing_times(self, origin: TimeOrigin) -> Floats:
        """(n,) s of column t as `times` has them. Raises FileError at the first row that is not after the one before"""
        t, shown = self.times("t", origin), self.text("t")
        back = np.flatnonzero(np.diff(t) <= 0)
        if len(back):
            i = back[0] + 1
            self.fail(f"time must increase: t = {shown[i]} s follows {shown[i - 1]} s", i, "t", shown[i])
        return t

    def whole(self, column: str) -> Integers:
        """(n,) integers of at least 0. Raises FileError at the first cell that is none."""
        values = self.numbers(column)
        bad = np.flatnonzero((values != np.round(values)) | (values < 0) | (values > LARGEST_WHOLE))
        if len(bad):
            limits = "of at least 0" + (f" and at most {LARGEST_WHOLE}" if values[bad[0]] > LARGEST_WHOLE else "")
            self.fail(
                f"column {column!r} must be a whole number {limits}, not {short_repr(self.text(column)[bad[0]])}",
                bad[0],
                column,
            )
        return values.astype(int)

    def matrix(self, columns: Iterable[str]) -> Floats:
        """(n, k) finite floats of several columns."""
        return np.stack([self.numbers(column) for column in columns], axis=1) if columns else np.zeros((len(self), 0))


def _number_problem(cell: str) -> str | None:
    """What is wrong with a cell that should be a number, in words, or None."""
    if len(cell) > LONGEST_NUMBER:
        return f"has {len(cell)} characters, more than any number needs"
    try:
        value = parse_number(cell)
    except NotFinite:
        return "is not finite"
    except ValueError:
        return "is not a number" if cell else "is empty"
    return "is too large to compute with" if abs(value) > LARGEST_NUMBER else None


POINTED = re.compile(r"\s*[-+]?\d+\.\d+\s*")  # a number with a point, which may stand for thousands


def read_csv_table(
    path: str | Path,
    required_columns: tuple[str, ...],
    optional_columns: tuple[str, ...] = (),
    form: TableFormat = PLAIN,
) -> Table:
    """Read the Table of a CSV file with required and optional columns in its header.

    required_columns : column names that must be there; optional_columns : names that may be. Further columns are kept,
        unless one looks
    like a slip of a known name; form : of the file
    Raises FileError: no file, no header, a column missing, twice given or misspelt, a row of another length, no rows.
    """
    path = Path(path)
    text = read_text(path)
    reader = csv.reader(StringIO(text, newline=""), delimiter=SEPARATORS[form.decimal])
    try:
        header = _header(path, next(reader, ()), required_columns, optional_columns)
        rows, lines = [], []
        for row in reader:
            if not (row and row[0].strip()) and not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                torn = (
                    len(row) < len(header) and reader.line_num == text.count("\n") + 1
                )  # the last line, and it does not end
                raise FileError(
                    path,
                    f"{len(row)} cells in a table of {len(header)} columns{' (cut off?)' if torn else ''}",
                    reader.line_num,
                    min(len(row), len(header)) or None,
                )
            rows.append(_with_points(path, row, reader.line_num) if form.decimal == "comma" else row)
            lines.append(reader.line_num)
    except csv.Error as error:
        raise FileError(path, f"not valid CSV: {error}", reader.line_num) from None
    if not rows:
        raise FileError(path, "has a header but no rows", 1)
    return Table(path, header, rows, np.array(lines), form)


def _with_points(path: Path, row: list[str], line: int) -> list[str]:
    """A row of decimal commas with points. Raises FileError for a number that has a point already."""
    for k, cell in enumerate(row):
        if POINTED.fullmatch(cell):
            raise FileError(path, f"{cell.strip()} has a point, in a file of decimal commas", line, k + 1)
    return [cell.replace(",", ".") for cell in row]


def _header(path: Path, cells: Iterable[str], required: tuple[str, ...], optional: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the columns, checked."""
    header = tuple(name.strip() for name in cells)
    if not any(header):
        raise FileError(path, f"is empty; its first line must name the columns {','.join(required)}", 1)
    if len(header) > MOST_COLUMNS:
        raise FileError(path, f"has {len(header)} columns, more than {MOST_COLUMNS}", 1)
    first: dict[str, int] = {}
    for place, name in enumerate(header, 1):
        if first.setdefault(name, place) != place:
            raise FileError(path, f"column {short_repr(name)} is given twice", 1, place, name)
    missing = [name for name in required if name not in first]
    if missing:
        other = next((name for name, sign in FOREIGN.items() if len(header) == 1 and sign in header[0]), None)
        hint = (
            ""
            if other is None
            else f"; it is separated by {other}s, and tables here are by commas with decimal points (docs/tables.md)"
        )
        raise FileError(
            path, f"column {missing[0]!r} is missing; the header is {short_repr(','.join(header))}{hint}", 1
        )
    absent = [name for name in optional if name not in first and len(name) > 2]
    for place, name in enumerate(header, 1):
        near = (
            difflib.get_close_matches(name[:64], absent, n=1, cutoff=0.8) if name not in (*required, *optional) else ()
        )
        if near:
            raise FileError(path, f"unknown column {short_repr(name)}; is {near[0]!r} meant?", 1, place, name)
    return header


MOST = 10_000_000  # rows


def is_parquet(path: Path) -> bool:
    """Whether a file is a Parquet file by its name."""
    return path.suffix.lower() in (".parquet", ".pq")


def read_parquet_cells(path: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    """Read a Parquet file as text cells.

    Timestamps as nanoseconds since 1970.
    Returns (header, rows)
    Raises MissingLibrary without pyarrow, FileError for what is no such file, for other types and for cells that are
        empty
    """
    pa, parquet = _library()
    with open_regular_file(path) as file:
        try:
            table = parquet.read_table(file)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise FileError(path, f"is not a readable Parquet file: {str(error).splitlines()[0]}") from None
    if not 0 < table.num_rows <= MOST:
        raise FileError(path, f"holds {table.num_rows} rows; a table has 1 to {MOST}")
    columns: list[tuple[str, list[str]]] = []
    for name, column in zip(table.column_names, table.columns):
        kind = column.type
        if column.null_count:
            raise FileError(path, f"column {name!r} has {column.null_count} empty cells")
        if pa.types.is_timestamp(kind):
            name, column = f"{name} [ns]", column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
        elif not any(
            fits(kind)
            for fits in (pa.types.is_integer, pa.types.is_floating, pa.types.is_string, pa.types.is_large_string)
        ):
            raise FileError(path, f"column {name!r} is of type {kind}; numbers, texts and timestamps are taken")
        columns.append((name, [value if isinstance(value, str) else repr(value) for value in column.to_pylist()]))
    return tuple(name for name, _ in columns), [list(row) for row in zip(*(values for _, values in columns))]


def parquet_bytes(columns: Mapping[str, Sequence[int] | Sequence[float] | Sequence[str]]) -> bytes:
    """Bytes of a Parquet file with columns {name: values}.

    Raises MissingLibrary without pyarrow.
    """
    pa, parquet = _library()
    buffer = pa.BufferOutputStream()
    parquet.write_table(pa.table(dict(columns)), buffer)
    return bytes(buffer.getvalue())


def _library() -> tuple[ModuleType, ModuleType]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MissingLibrary("Parquet files need the package pyarrow: pip install 'rig[parquet]'") from None
    return pyarrow, pyarrow.parquet
