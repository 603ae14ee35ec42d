"""Tables without header or time column: TUM trajectories, halsampler samples, rows at a fixed period."""

import re
from dataclasses import dataclass, replace
from decimal import Decimal

from rig.errors import FileError
from rig.formats.importers.import_recipe import ForeignTable
from rig.recording.time_origin import DIGITS

TUM = "t x y z qx qy qz qw"  # what its eight columns are, the quaternion's real part last
SAMPLE = ("sample", "samplenumber", "tick", "n")
LOST = "overrun"  # a line that halsampler writes where samples were lost
FIGURES = re.compile(r"[-+0-9.eE]+( +[-+0-9.eE]+){7}")


@dataclass(frozen=True, slots=True)
class Headed:
    """lines : (number, text) pairs, a header first; table : ForeignTable with the header; said : sentences."""

    lines: list[tuple[int, str]]
    table: ForeignTable
    said: tuple[str, ...] = ()


def lines_with_header(table: ForeignTable, section: str, lines: list[tuple[int, str]]) -> Headed:
    """Lines of a table with a header added where it has none: the stated one, or TUM's.
    section : of the table's section

    Raises FileError where samples were lost and nothing tells when
    """
    if (
        table.header is None
        and section == "poses"
        and table.separator in (None, "space")
        and all(FIGURES.fullmatch(text) for _, text in lines[:2])
    ):
        return Headed(
            [(0, TUM), *lines],
            replace(table, header=TUM, separator="space", decimal="point"),
            (f"{table.file.name} has no header and eight columns: a trajectory as TUM's, {TUM}, in m",),
        )
    if table.header is None:
        return Headed(lines, table)
    lost = [number for number, text in lines if text == LOST]
    if lost and not _sample_column(table.header.replace(",", " ").split()):
        raise FileError(
            table.file,
            "samples were lost here and nothing tells how many: log with halsampler -t, and name the first "
            "column sample",
            lost[0],
        )
    said = (f"{table.file.name}: samples were lost {len(lost)} times, first at line {lost[0]}",) if lost else ()
    return Headed([(0, table.header), *(line for line in lines if line[1] != LOST)], table, said)


def _sample_column(header: list[str]) -> str | None:
    """The column that counts samples, or None."""
    return next((word for word in header if re.sub(r"[^a-z]", "", word.lower()) in SAMPLE), None)


def add_time_column(
    table: ForeignTable, header: tuple[str, ...], rows: list[list[str]]
) -> tuple[tuple[str, ...], list[list[str]]]:
    """Table (header, rows) with a time column added where a period is stated.

    Raises FileError for samples that are no whole numbers
    """
    if table.period is None:
        return header, rows
    count, by = _sample_column(list(header)), Decimal(repr(table.period))
    numbers = [str(k) for k in range(len(rows))] if count is None else [row[header.index(count)] for row in rows]
    for number in numbers:
        if not re.fullmatch(r"\d{1,15}", number):
            raise FileError(
                table.file, f"column {count} counts samples, and {number!r} is no whole number", value=number
            )
    return (*header, "t [s]"), [
        [*row, f"{DIGITS.multiply(Decimal(number), by):f}"] for row, number in zip(rows, numbers)
    ]
