"""CSV dialect of a foreign table.

Encoding, separator, decimal sign and comments, detected.
"""

import csv
import re
from dataclasses import replace
from pathlib import Path

from rig.errors import FileError
from rig.formats.csv_and_parquet_tables_and_time_origin import is_parquet, read_parquet_cells
from rig.formats.importers.foreign_file_import_recipe import DECIMALS, SEPARATORS, ForeignTable
from rig.formats.importers.foreign_table_column_search_and_completion import (
    LONGEST,
    NUMBER,
    Cells,
    add_time_column,
    lines_with_missing_header_added,
)
from rig.formats.importers.foreign_table_units_and_timestamps import ambiguity_error
from rig.formats.importers.yaml_and_matlab_tables_and_array_cells import (
    APART,
    cells_with_arrays_as_columns,
    is_array_cell,
    is_matlab,
    is_yaml,
    read_matlab_rows,
    read_yaml_rows,
)
from rig.formats.local_and_remote_input_files import read_bytes, short_repr

LARGEST = 1 << 27  # bytes
COMMENTS = ("#", "%", "//")
LOOKED_AT = 2000  # rows by which a dialect is told; every row must have as many cells in the end
MOST_COLUMNS = 1000
LONGEST_CELL = 300  # characters
TORN = re.compile(r"\d[;\t, ]+[-+]?[\d.,]")  # a cell that another separator would part
EXCEL = re.compile(r"sep=.")  # a first line by which Excel knows the separator
DATE = re.compile(r"(\d{4}-?\d\d-?\d\d|\d{1,2}[./]\d{1,2}[./]\d{4})([T ]\d\d.*)?")
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")


def read_foreign_table_header_and_cells(table: ForeignTable, section: str) -> Cells:
    """Read the header and rows of texts (Cells) of a foreign table of any CSV dialect.

    section : of its section in a recipe, as settings call it

    Raises FileError for what is no table, RigError for one that reads well in two ways
    """
    return cells_with_arrays_as_columns(_read_cells(table, section), section)


def _read_cells(table: ForeignTable, section: str) -> Cells:
    """The same with cells as they are written."""
    if is_parquet(table.file):
        header, rows = add_time_column(table, *read_parquet_cells(table.file))
        return Cells(table.file, header, rows, list(range(1, len(rows) + 1)), table, ())
    if is_yaml(table.file) or is_matlab(table.file):
        read = read_yaml_rows(table.file, section) if is_yaml(table.file) else read_matlab_rows(table.file)
        header, rows = add_time_column(table, read.header, read.rows)
        return Cells(table.file, header, rows, read.lines, table, read.remarks)
    content, words = _decoded(table.file)
    with_header = lines_with_missing_header_added(table, section, _lines(table.file, content, table.header is None))
    lines, table, words = with_header.lines, with_header.table, (*words, *with_header.remarks)
    fits = _fitting(table, lines)
    if not fits:
        whole = _fitting(table, lines[:-1]) if len(lines) > 2 else []
        if whole:
            raise FileError(
                table.file,
                f"its last line is not like the {len(whole[0].rows)} before it, of {len(whole[0].header)} "
                "cells each: the "
                f"file is cut off; correct the line or remove it: {short_repr(lines[-1][1])}",
                lines[-1][0],
            )
        _no_names(table, section, lines)
        _require_alike(table, lines)
        raise FileError(
            table.file,
            "is not a table with a header line and rows of as many cells, separated by comma, semicolon, tab or "
            "spaces, with "
            "decimal points or commas; its separator and decimal can be stated: "
            f"--set {section}.separator=semicolon --set {section}.decimal=comma",
        )
    first = fits[0]
    others = [other for other in fits[1:] if other.rows != first.rows or other.header != first.header]
    if others:

        def setting(one: Cells) -> str:
            key = "decimal" if one.table.separator == first.table.separator else "separator"
            return f"{section}.{key}={getattr(one.table, key)}"

        raise ambiguity_error(
            f"{table.file}: line {first.lines[0]} can be read in {len(others) + 1} ways",
            [
                (
                    f"{one.table.separator}s between, decimal {one.table.decimal}s: {', '.join(one.rows[0][:4])}",
                    setting(one),
                )
                for one in (first, *others)
            ],
        )
    _no_groups(table, first, lines, section)
    header, rows = add_time_column(table, first.header, first.rows)
    return Cells(first.path, header, rows, first.lines, first.table, (*words, *first.remarks))


def _no_names(table: ForeignTable, name: str, lines: list[tuple[int, str]]) -> None:
    """Raise FileError where it is only the names of the columns that a table lacks, or that are of another number."""
    figures = lines if table.header is None else lines[1:]
    for separator in SEPARATORS if table.separator is None else (table.separator,):
        try:
            count = len(_split(figures[0][1], separator)) if figures else 0
        except csv.Error:  # it is no row of this dialect
            continue
        names = [f"column{i}" for i in range(count)]
        if count > 1 and _fitting(replace(table, header=" ".join(names), separator=separator), [(0, ""), *figures]):
            if table.header is None:
                raise FileError(
                    table.file,
                    f"has no header line: name its {count} columns, --set '{name}.header=..', their names "
                    "apart by spaces",
                    1,
                )
            stated = len(table.header.replace(",", " ").split())
            raise FileError(
                table.file, f"has {count} cells in a row, and {name}.header names {stated} columns", figures[0][0]
            )


def _require_alike(table: ForeignTable, lines: list[tuple[int, str]]) -> None:
    """Raise FileError at the first line unlike the others, in the dialect that fits most lines; none fits all."""
    least, rows = len(lines) / 2, lines[1 : LOOKED_AT + 1]
    found: FileError | None = None
    for separator in SEPARATORS if table.separator is None else (table.separator,):
        try:
            header = lines[0][1] if table.header is None else table.header.replace(",", " ")
            names = _split(header, separator if table.header is None else "space")
            cells = [_split(line, separator) for _, line in rows]
        except csv.Error:  # it is no row of this dialect
            continue
        for decimal in DECIMALS if table.decimal is None else (table.decimal,):
            odd = [k for k, row in enumerate(cells) if not _fit([names, row], decimal)]
            if odd and len(odd) < least:
                least, (line, text) = len(odd), rows[odd[0]]
                dialect = f"{len(names)} cells, {separator}s between, with decimal {decimal}s"
                message = f"{short_repr(text)} is not as {len(rows) - len(odd)} of {len(rows)} rows, of {dialect}"
                found = FileError(table.file, f"{message}; correct the line or remove it", line)
    if found is not None:
        raise found


def _fitting(table: ForeignTable, lines: list[tuple[int, str]]) -> list[Cells]:
    """Cells of every dialect, of those that the table leaves open, that fits all lines."""
    tried = (
        _parsed(table, lines, separator, decimal)
        for separator in (SEPARATORS if table.separator is None else (table.separator,))
        for decimal in (DECIMALS if table.decimal is None else (table.decimal,))
    )
    return [found for found in tried if found is not None]


def _decoded(path: Path) -> tuple[str, tuple[str, ...]]:
    """(text, what is said of its encoding) of UTF-8, UTF-16 with a mark, or else what Windows writes in western
    Europe.
    """
    data = read_bytes(path, LARGEST)
    try:
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return data.decode("utf-16"), (f"{path.name} is UTF-16 text",)
        return data.decode("utf-8-sig"), ()
    except UnicodeDecodeError:
        pass
    try:
        content = data.decode("cp1252")
    except UnicodeDecodeError:
        raise FileError(path, "is not text in UTF-8, UTF-16 or Windows-1252") from None
    return content, (f"{path.name} is read as Windows-1252 text, as it is not UTF-8",)


def _lines(path: Path, content: str, commented: bool) -> list[tuple[int, str]]:
    """(number, text) of the header and the rows. commented : whether a header in the last comment before figures
    counts
    """
    if "\0" in content:
        raise FileError(path, "is not text: it contains a NUL byte", content.count("\n", 0, content.index("\0")) + 1)
    lines, comment = [], None
    for number, line in enumerate(content.splitlines(), 1):
        bare = line.strip(" \r\n")
        if not bare.strip() or (number == 1 and EXCEL.fullmatch(bare)):
            continue
        mark = next((mark for mark in COMMENTS if bare.startswith(mark)), None)
        if mark is None:
            lines.append((number, bare))
        elif not lines:
            comment = (number, bare[len(mark) :].strip(" "))
    if (
        lines
        and comment
        and commented
        and not re.search(r"[A-Za-z]{2}|^[A-Za-z]", re.sub(r"[eE][+-]?\d|\dT\d", "", lines[0][1]))
    ):
        lines.insert(0, comment)  # as numpy.savetxt writes its header
    if not lines:
        raise FileError(path, "is empty: it needs a header line and rows below it")
    if len(lines) < 2:
        raise FileError(path, f"has no rows below its only line, {short_repr(lines[0][1])}", lines[0][0])
    return lines


def _parsed(table: ForeignTable, lines: list[tuple[int, str]], separator: str, decimal: str) -> Cells | None:
    """Cells as one dialect has them, or None where it does not fit all rows."""
    try:
        rows = [_split(line, separator) for _, line in lines[: LOOKED_AT + 1]]
        if table.header is not None:
            rows[0] = table.header.replace(",", " ").split()
        if not _fit(rows, decimal):
            return None
        rows += [_split(line, separator) for _, line in lines[LOOKED_AT + 1 :]]
    except csv.Error:
        return None
    header, *body = rows
    numbers = [number for number, _ in lines[1:]]
    odd = next((i for i, row in enumerate(body) if len(row) != len(header) or _too_long(row)), None)
    if odd is not None and len(body[odd]) == len(header):
        raise FileError(table.file, f"a cell has more than {LONGEST_CELL} characters", numbers[odd])
    if odd is not None:
        raise FileError(table.file, f"{len(body[odd])} cells in a table of {len(header)} columns", numbers[odd])
    retained = [
        k for k, name in enumerate(header) if name or any(row[k] for row in body)
    ]  # a separator at the ends of lines makes an empty column
    body = [[_point(row[k], decimal) for k in retained] for row in body]
    remarks = (
        ()
        if table.separator and table.decimal
        else (f"{table.file.name}: {separator}s between the cells, decimal {decimal}s",)
    )
    return Cells(
        table.file,
        tuple(header[k] for k in retained),
        body,
        numbers,
        replace(table, separator=separator, decimal=decimal),
        remarks,
    )


def _too_long(row: list[str]) -> bool:
    return any(len(cell) > LONGEST_CELL and not is_array_cell(cell) for cell in row)


def _split(line: str, separator: str) -> list[str]:
    if separator == "space":
        return _lists_joined(line.split(), " ")
    sign = SEPARATORS[separator]
    return _lists_joined([cell.strip() for cell in next(csv.reader([line], delimiter=sign), [])], sign)


def _lists_joined(cells: list[str], sign: str) -> list[str]:
    """Cells, with what lies within brackets as one: lists that are written without quotation marks."""
    if not any(cell.startswith("[") for cell in cells):
        return cells
    out: list[str] = []
    depth = 0
    for cell in cells:
        if depth > 0:
            out[-1] += f"{sign} {cell}"
        else:
            out.append(cell)
        if depth > 0 or cell.startswith("["):
            depth += cell.count("[") - cell.count("]")
    return out


def _fit(rows: list[list[str]], decimal: str) -> bool:
    header, *body = rows
    if not 2 <= len(header) <= MOST_COLUMNS or len({len(row) for row in rows}) > 1:
        return False
    if any(_too_long(row) for row in rows) or NUMBER["point"].fullmatch(header[0]) or DATE.fullmatch(header[0]):
        return False
    figures = 0
    for row in body:
        for cell in row:
            if is_array_cell(cell) or (
                len(cell) <= LONGEST and (NUMBER[decimal].fullmatch(cell) or DATE.fullmatch(cell))
            ):
                figures += 1
            elif (cell and TORN.search(cell) and not DATE.match(cell)) or NUMBER[
                "comma" if decimal == "point" else "point"
            ].fullmatch(cell):
                return False
    return figures > 0


def _point(cell: str, decimal: str) -> str:
    """A cell with a decimal point; the numbers of a list apart by one space, whatever was between them."""
    if is_array_cell(cell):
        return APART.sub(" ", cell)
    return cell.replace(",", ".") if decimal == "comma" and NUMBER["comma"].fullmatch(cell) else cell


def _no_groups(table: ForeignTable, found: Cells, lines: list[tuple[int, str]], name: str) -> None:
    """Raise RigError where every decimal comma could as well part thousands."""
    if table.decimal is not None or found.table.decimal != "comma":
        return
    separator = found.table.separator or "comma"
    cells = [
        cell
        for _, line in lines[1:]
        for cell in _split(line, separator)
        if "," in cell and NUMBER["comma"].fullmatch(cell)
    ]
    if cells and all(GROUPED.fullmatch(cell) for cell in cells):
        raise ambiguity_error(
            f"{table.file}: {cells[0]} can be read in two ways",
            [
                (f"{cells[0].replace(',', '.')}, a decimal comma", f"{name}.decimal=comma"),
                (
                    f"{cells[0].replace(',', '')}, thousands separated (remove the commas from the file)",
                    f"{name}.decimal=point",
                ),
            ],
        )
