"""Parquet tables (pyarrow): read as text cells like a CSV, written with typed columns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType

from rig.errors import FileError, MissingLibrary
from rig.formats.input_files import open_regular_file

MOST = 10_000_000  # rows


def is_parquet(path: Path) -> bool:
    """Whether a file is a Parquet file by its name."""
    return path.suffix.lower() in (".parquet", ".pq")


def read_parquet_cells(path: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    """Read a Parquet file as text cells: (header, rows); timestamps as nanoseconds since 1970.

    Raises MissingLibrary without pyarrow, FileError for what is no such file, for other types and for cells that are
        empty
    """
    pa, parquet = _library()
    with open_regular_file(path) as file:
        try:
            table = parquet.read_table(file)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise FileError(path, f"is no Parquet file that can be read: {str(error).splitlines()[0]}") from None
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
    """Bytes of a Parquet file with columns {name: values}. Raises MissingLibrary without pyarrow."""
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
