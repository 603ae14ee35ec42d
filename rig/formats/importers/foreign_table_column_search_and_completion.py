"""Columns of foreign tables found by their headers, and missing headers and times added.

Cells as text and numbers.
"""

import difflib
import re
import shlex
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

from rig.array_and_json_types import Floats
from rig.errors import FileError, RigError
from rig.formats.checked_toml_and_json_entries import LARGEST_NUMBER
from rig.formats.csv_and_parquet_tables_and_time_origin import DIGITS
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.importers.foreign_table_units_and_timestamps import (
    TIMES,
    Times,
    UnclearInput,
    header_name_and_unit,
    index_of_first_unreadable_time,
    read_times,
    unrecognised_unit_of_header,
)
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.numbers_and_units import ANGLES, LENGTHS

TIME = {
    "t": (
        *("t", "time", "timestamp", "stamp", "zeit", "zeitstempel", "uhrzeit", "elapsed", "elapsedtime"),
        *("epoch", "datetime", "utc", "unixtime", "clock", "zeitpunkt", "aufnahmezeit", "temps", "horodatage"),
        *("heure", "tiempo", "hora", "fechahora", "marcadetiempo", "时间", "时间戳", "时刻", "時間"),
    )
}  # {our name of a column: what its header may be called, without accents}
FRAME = {
    "frame": (
        *("frame", "index", "nr", "no", "number", "i", "id", "bild", "n", "pose", "point", "nummer", "bildnummer"),
        *("numero", "trame", "cuadro", "fotograma", "帧", "帧号", "编号", "序号"),
    )
}
IMAGE = {
    "image": (
        *("image", "file", "filename", "img", "picture", "path", "bilddatei", "datei", "dateiname", "fichier"),
        *("photo", "imagen", "archivo", "fichero", "foto", "图像", "图片", "文件", "文件名"),
    )
}
CAMERA = {"camera": ("camera", "cam", "kamera", "appareil", "camara", "相机", "摄像头")}
DIRECTION: dict[str, tuple[str, ...]] = {
    "azimuth": ("azimuth", "az", "azm", "azimut", "azobs", "azobserved", "acimut", "方位角"),
    "elevation": ("elevation", "el", "alt", "altitude", "elobs", "altobs", "hohe", "hoehe", "elevacion", "仰角"),
}
LIMB = (
    *(
        "l",
        "leg",
        "strut",
        "length",
        "actuator",
        "act",
        "axis",
        "limb",
        "bein",
        "m",
        "pos",
        "strebe",
        "lange",
        "laenge",
    ),
    *("zylinder", "verin", "jambe", "longueur", "pierna", "pata", "longitud", "actuador", "cilindro"),
    *("腿", "支腿", "杆", "杆长", "缸", "长度"),
)
JOINT = (
    *("q", "joint", "j", "theta", "axis", "a", "angle", "gelenk", "achse", "winkel", "articulation", "axe"),
    *("articulacion", "eje", "angulo", "关节", "轴", "角度"),
)


LONGEST = 100  # characters of a number
ALIKE = 0.6  # of difflib's ratio, between a header and a known word that it likely means
NUMBER = {
    "point": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII),
    "comma": re.compile(r"[+-]?(\d+(,\d*)?|,\d+)([eE][+-]?\d{1,3})?", re.ASCII),
}


@dataclass(frozen=True, slots=True)
class Cells:
    """A table as text. path; header : n names; rows : lists of n texts, decimals with a point; lines : of the file,
    from 1
    table : ForeignTable with separator and decimal; remarks : sentences about what was found out."""

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    table: ForeignTable
    remarks: tuple[str, ...]

    def column(self, at: int) -> list[str]:
        """A column's texts. at : index"""
        return [row[at] for row in self.rows]

    def numbers(self, at: int) -> list[float]:
        """A column's numbers. Raises FileError at the first that is none."""
        return [self._number(row[at], line, at) for row, line in zip(self.rows, self.lines)]

    def whole_numbers(self, at: int) -> list[int]:
        """A column's numbers, such as of frames. Raises FileError at the first that is not whole."""
        values = self.numbers(at)
        for value, line in zip(values, self.lines):
            if not value.is_integer():
                message = f"column {short_repr(self.header[at])} numbers frames, and {value:g} is not a whole number"
                raise FileError(self.path, message, line, at + 1, value)
        return [int(value) for value in values]

    def unit(self, at: int) -> str | None:
        """Unit that a column's header states, or None."""
        return header_name_and_unit(self.header[at])[1]

    def known_unit(self, at: int, setting: str) -> str | None:
        """The same. Raises FileError for a word in brackets that is none. setting : KEY=VALUE that states another"""
        unit, word = self.unit(at), unrecognised_unit_of_header(self.header[at])
        if unit is None and word is not None:
            message = f"column {short_repr(self.header[at])} is in {short_repr(word)}, which is no known unit; convert "
            raise FileError(self.path, f"{message}it, or state its unit: --set {setting}", value=word)
        return unit

    def times(self, at: int, section: str, stated: ForeignTable, are_plausible: Callable[[Floats], bool]) -> Times:
        """A column's times, in the unit stated for the table or by the header; see `read_times`. Raises FileError at
        the first that is none.
        """
        unit = stated.time_unit or (self.unit(at) if self.unit(at) in TIMES else None)
        odd = index_of_first_unreadable_time(self.column(at), unit)
        if odd is not None:
            cell, header = self.rows[odd][at], short_repr(self.header[at])
            message = f"column {header}: {short_repr(cell)} is not a time{f' in {unit}' if unit else ''}: times are "
            message += "numbers, or ISO 8601 as 2026-01-31T12:00:00.25Z"
            raise FileError(self.path, message, self.lines[odd], at + 1, cell)
        return read_times(self.column(at), section, stated.file.name, unit, stated.zone, stated.shift, are_plausible)

    def _number(self, cell: str, line: int, at: int) -> float:
        if len(cell) > LONGEST or not NUMBER["point"].fullmatch(cell) or abs(float(cell)) > LARGEST_NUMBER:
            raise FileError(
                self.path,
                f"column {short_repr(self.header[at])} is not a valid number: {short_repr(cell)}",
                line,
                at + 1,
                cell,
            )
        return float(cell)


def _normalised_header(header: str) -> str:
    """A header's name without its unit, capitals and punctuation: what is compared."""
    plain = unicodedata.normalize("NFKD", header_name_and_unit(header)[0].lower())
    return re.sub(r"[\W_]+", "", "".join(one for one in plain if not unicodedata.combining(one)))


def accepted_header_names_of_axes(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Accepted header names of axes, {axis: names}.

    Returns {axis: names} of the axes l1.. or q1.., and of others their own names
    """
    words = {"l": LIMB, "q": JOINT}
    return {
        name: tuple(f"{word}{name[1:]}" for word in words[name[0]])
        if re.fullmatch(r"[lq]\d+", name)
        else (_normalised_header(name),)
        for name in names
    }


def column_indices_by_headers(
    cells: Cells,
    section: str,
    header_names: Mapping[str, tuple[str, ...]],
    required_names: Iterable[str],
    axis_units: Mapping[str, str] | None = None,
) -> dict[str, int]:
    """Indices of columns {our name: column index} found by accepted headers.

    header_names : {our name: what a header may be called}; required_names : that must be there; axis_units : {our name:
        "m" or "rad"} of axes. Raises RigError for what is missing or there twice
    Returns {our name: column index}
    """
    stated = dict(cells.table.columns)
    prefix = _shared_prefix(cells.header, [header_names[ours] for ours in required_names if ours not in stated])
    words = [_normalised_header(header.removeprefix(prefix)) for header in cells.header]
    found: dict[str, int] = {}
    for ours, names in header_names.items():
        if ours in stated:
            if stated[ours] not in cells.header:
                raise FileError(
                    cells.path, f"has no column {short_repr(stated[ours])}; its header is {', '.join(cells.header)}"
                )
            found[ours] = cells.header.index(stated[ours])
            continue
        exact = [k for k, header in enumerate(cells.header) if header == ours]
        alike = exact or [
            k for k, header in enumerate(cells.header) if words[k] in names and header not in stated.values()
        ]
        if len({cells.header[k] for k in alike}) < len(alike):
            name = short_repr(cells.header[alike[0]])
            which = " and ".join(str(k + 1) for k in alike)
            raise FileError(cells.path, f"columns {which} are both named {name}; rename all but one in its header line")
        if len(alike) > 1:
            raise RigError(
                "\n".join(
                    [
                        f"{cells.path}: several columns can be {ours}:",
                        *(f"  {cells.header[k]}: --set '{section}.columns.{ours}={cells.header[k]}'" for k in alike),
                    ]
                )
            )
        if alike:
            found[ours] = alike[0]
    missing = [ours for ours in header_names if ours not in found and (ours in required_names or ours == "t")]
    supposed = _columns_in_order(cells, missing, axis_units or {}, set(found.values()))
    missing_still = [ours for ours in missing if ours not in supposed]
    used = {*found.values(), *(cells.header.index(header) for header in supposed.values())}
    supposed |= _supposed_columns(cells, missing_still, header_names, used)
    absent = [ours for ours in missing if ours in required_names or ours in supposed]
    if any(ours in required_names or header_name_and_unit(supposed[ours])[1] in TIMES for ours in absent):
        unread = [header for k, header in enumerate(cells.header) if k not in found.values()]
        lines = [
            f"  {ours}: "
            + (
                f"likely {short_repr(supposed[ours])}: "
                f"--set {shlex.quote(f'{section}.columns.{ours}={supposed[ours]}')}"
                if ours in supposed
                else f"--set '{section}.columns.{ours}=HEADER'"
            )
            for ours in absent
        ]
        raise UnclearInput(
            "\n".join(
                [
                    f"{cells.path}: no column is {', '.join(absent)}; columns of unknown meaning are "
                    f"{', '.join(unread) or 'none'}; state which one it is:",
                    *lines,
                ]
            ),
            tuple(f"{section}.columns.{ours}={supposed[ours]}" for ours in absent if ours in supposed),
            all(ours in supposed for ours in absent),
        )
    return found


def _shared_prefix(header: Sequence[str], required: Sequence[tuple[str, ...]]) -> str:
    """What stands before all required columns, as "measured_" of measured_x, measured_y, measured_z; "" where they
    are there without, and where several prefixes are possible.

    required : of each column what its header may be called
    """
    plain = {_normalised_header(one) for one in header}
    parts = [
        match.groups() for one in header if (match := re.fullmatch(r"(.+[\W_])([^\W_]+)", header_name_and_unit(one)[0]))
    ]
    before = [{prefix for prefix, word in parts if _normalised_header(word) in names} for names in required]
    shared = (
        set.intersection(*before) if len(required) > 1 and all(plain.isdisjoint(one) for one in required) else set()
    )
    return shared.pop() if len(shared) == 1 else ""


def _columns_in_order(
    cells: Cells, missing: Sequence[str], axis_units: Mapping[str, str], used: set[int]
) -> dict[str, str]:
    """{axis: header} of missing axes that turn and slide, where as many columns as these have units of angles and
    lengths in their order; else none.
    """
    axes = [ours for ours in missing if ours in axis_units]
    wanted = [axis_units[ours] for ours in axes]
    if len(set(wanted)) < 2:
        return {}
    kinds = {**dict.fromkeys(ANGLES, "rad"), **dict.fromkeys(LENGTHS, "m")}
    units = [(header, kinds.get(cells.unit(k) or "")) for k, header in enumerate(cells.header) if k not in used]
    left = [(header, unit) for header, unit in units if unit is not None]
    if wanted != [unit for _, unit in left]:
        return {}
    return {ours: header for ours, (header, _) in zip(axes, left)}


def _supposed_columns(
    cells: Cells, missing: Sequence[str], header_names: Mapping[str, tuple[str, ...]], used: set[int]
) -> dict[str, str]:
    """{our name: header} of likely columns: numbered headers that share a word, increasing ones for t, like words."""
    left = {header: _normalised_header(header) for k, header in enumerate(cells.header) if k not in used}
    numbered = [re.fullmatch(r"(.*?)(\d+)", word) for word in left.values()]
    stems = [match[1] for match in numbered if match]
    stem = max(stems, key=stems.count, default="")
    found: dict[str, str] = {}
    for header, match in zip(list(left), numbered):
        ours = next((name for name in missing if match and re.fullmatch(rf"[lq]{match[2]}", name)), None)
        if match and match[1] == stem and ours is not None:
            found[ours] = header
            del left[header]
    for ours in [name for name in missing if name not in found]:
        words = {word: header for header, word in left.items() if word}
        ratios = {
            word: max(
                difflib.SequenceMatcher(None, word, known).ratio() for known in header_names[ours] if len(known) > 2
            )
            for word in words
        }
        best = max(ratios, key=ratios.__getitem__, default=None)
        near = words[best] if best is not None and ratios[best] >= ALIKE else None
        if near is None and ours == "t":
            near = next((header for header in left if _increases(cells, cells.header.index(header))), None)
        if near is not None:
            found[ours] = near
            del left[near]
    return found


def _increases(cells: Cells, at: int) -> bool:
    """Whether a column has numbers that only increase."""
    texts = cells.column(at)
    if not all(len(text) <= LONGEST and NUMBER["point"].fullmatch(text) for text in texts):
        return False
    values = [Decimal(text) for text in texts]
    return len(values) > 1 and all(a < b for a, b in zip(values, values[1:]))


def column_headers_for_import_recipe(
    table: ForeignTable, cells: Cells, column_indices: dict[str, int]
) -> tuple[tuple[str, str], ...]:
    """Column headers ((our name, their header), ..) for an import recipe to store."""
    return tuple((ours, cells.header[at]) for ours, at in column_indices.items())


TUM = "t x y z qx qy qz qw"  # what its eight columns are, the quaternion's real part last
SAMPLE = ("sample", "samplenumber", "tick", "n")
LOST = "overrun"  # a line that halsampler writes where samples were lost
FIGURES = re.compile(r"[-+0-9.eE]+( +[-+0-9.eE]+){7}")


@dataclass(frozen=True, slots=True)
class TableWithHeader:
    """lines : (number, text) pairs, a header first; table : ForeignTable with the header; remarks : sentences."""

    lines: list[tuple[int, str]]
    table: ForeignTable
    remarks: tuple[str, ...] = ()


def lines_with_missing_header_added(table: ForeignTable, section: str, lines: list[tuple[int, str]]) -> TableWithHeader:
    """Lines of a table with a header added where it has none.

    The stated one, or TUM's.
    section : of the table's section

    Raises FileError where samples were lost and nothing tells when
    """
    if (
        table.header is None
        and section == "poses"
        and table.separator in (None, "space")
        and all(FIGURES.fullmatch(text) for _, text in lines[:2])
    ):
        return TableWithHeader(
            [(0, TUM), *lines],
            replace(table, header=TUM, separator="space", decimal="point"),
            (f"{table.file.name} has no header and eight columns: a trajectory as TUM's, {TUM}, in m",),
        )
    if table.header is None:
        return TableWithHeader(lines, table)
    lost = [number for number, text in lines if text == LOST]
    if lost and not _sample_column(table.header.replace(",", " ").split()):
        raise FileError(
            table.file,
            "samples were lost here and nothing states how many: log with halsampler -t, and name the first "
            "column sample",
            lost[0],
        )
    message = (f"{table.file.name}: samples were lost {len(lost)} times, first at line {lost[0]}",) if lost else ()
    return TableWithHeader([(0, table.header), *(line for line in lines if line[1] != LOST)], table, message)


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
                table.file, f"column {count} counts samples, and {number!r} is not a whole number", value=number
            )
    return (*header, "t [s]"), [
        [*row, f"{DIGITS.multiply(Decimal(number), by):f}"] for row, number in zip(rows, numbers)
    ]
