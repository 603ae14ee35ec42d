"""Foreign tables of commands.

Read into a recording's commands.csv.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.checks.mistake_dataclass_and_clock_mistakes import FASTEST, SLOWEST, USUAL
from rig.errors import FileError, RigError
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.importers.foreign_table_column_search_and_completion import (
    DIRECTION,
    FRAME,
    TIME,
    Cells,
    accepted_header_names_of_axes,
    column_headers_for_import_recipe,
    column_indices_by_headers,
)
from rig.formats.importers.foreign_table_units_and_timestamps import (
    ambiguity_error,
    fits_ranges_within_a_tenth,
    is_likely_length_unit,
    likely_length_units_and_zeros,
)
from rig.formats.numbers_and_units import ANGLES, LENGTHS
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, has_struts, require_axes


@dataclass(frozen=True, slots=True, eq=False)
class ImportedCommands:
    """t : n exact s, or None where the table has none; values : (n, axes) m or rad; frame : (n,) int or None;
    table : ForeignTable as found out.
    """

    t: list[Decimal] | None
    values: Floats
    frame: Integers | None
    table: ForeignTable
    remarks: tuple[str, ...]


def read_commands(table: ForeignTable, design: Design) -> ImportedCommands:
    """Read the commands of a foreign table.

    Raises RigError for what cannot be used and for what reads well in two ways.
    """
    axes = design.mechanism.axes
    if not axes:
        raise RigError(f'{table.file}: nothing can be commanded of a mechanism of kind "{design.mechanism.kind}"')
    cells = read_foreign_table_header_and_cells(table, "commands")
    names = accepted_header_names_of_axes(axes)
    if design.instrument is not None and design.instrument.kind == "direction" and len(axes) == len(DIRECTION):
        names = {axis: (*names[axis], *words) for axis, words in zip(axes, DIRECTION.values())}
    units = dict(zip(axes, mechanisms.axis_units(design.mechanism)))
    found = column_indices_by_headers(cells, "commands", {**TIME, **FRAME, **names}, axes, units)
    values, table, value_remarks = _values(
        cells,
        [found[name] for name in axes],
        replace(cells.table, columns=column_headers_for_import_recipe(table, cells, found)),
        design,
    )
    frame = None if "frame" not in found else np.array(cells.whole_numbers(found["frame"]))
    t, lines = None, (*cells.remarks, *value_remarks)
    if "t" in found:
        read_times = cells.times(found["t"], "commands", table, _pace(values, design))
        t, lines = read_times.seconds, (*lines, *read_times.remarks)
        table = replace(table, time_unit=read_times.unit, zone=read_times.zone)
    return _once(ImportedCommands(t, values, frame, table, lines), cells)


def _once(commanded: ImportedCommands, cells: Cells) -> ImportedCommands:
    """The rows without those that a log has twice. Raises FileError, with the line, where times decrease and where
    rows of one time say different things.
    """
    t, values = commanded.t, commanded.values
    if t is None:
        return commanded
    back = next((k for k in range(1, len(t)) if t[k] < t[k - 1]), None)
    if back is not None:
        message = (
            f"its time, {t[back]:f} s, is before that of line {cells.lines[back - 1]}, {t[back - 1]:f} s; sort the"
        )
        raise FileError(cells.path, f"{message} rows by time, or correct it", cells.lines[back])
    repeated = [k for k in range(1, len(t)) if t[k] == t[k - 1]]
    odd = next((k for k in repeated if not np.array_equal(values[k], values[k - 1])), None)
    if odd is not None:
        raise FileError(
            cells.path, f"two rows are of one time, {t[odd]:f} s, and differ; remove one of them", cells.lines[odd]
        )
    if not repeated:
        return commanded
    keep = np.setdiff1d(np.arange(len(t)), repeated)
    remarks = (
        f"{cells.path.name}: {len(repeated)} rows occur twice, with their times, and are used once; the "
        f"first is line {cells.lines[repeated[0]]}",
    )
    return replace(
        commanded,
        t=[t[k] for k in keep],
        values=values[keep],
        remarks=(*commanded.remarks, *remarks),
        frame=None if commanded.frame is None else commanded.frame[keep],
    )


def _values(
    cells: Cells, at: list[int], table: ForeignTable, design: Design
) -> tuple[Floats, ForeignTable, tuple[str, ...]]:
    """((n, axes) m or rad, ForeignTable with the unit, sentences)."""
    values, m = np.array([cells.numbers(k) for k in at]).T, require_axes(design.mechanism)
    stated = [None if table.unit else cells.known_unit(k, "commands.unit=mm (or deg, ..)") for k in at]
    if not has_struts(m):
        return _of_axes(values, stated, table, m)
    units = {table.unit or unit for unit in stated}
    if len(units) > 1:
        raise RigError(
            f"{table.file}: its columns are in different units "
            f"({', '.join(sorted(str(u or 'none stated') for u in units))}); "
            "bring them to one unit, or state it: --set commands.unit=mm"
        )
    unit = units.pop()
    if unit is not None and unit not in (*LENGTHS, "steps"):
        raise RigError(f"{table.file}: {unit} is not a unit of lengths; there are {', '.join(LENGTHS)}, steps")
    if unit == "steps":
        if table.steps_per_mm is None:
            raise RigError(
                f"{table.file}: lengths are in steps; how many make a millimetre? --set commands.steps_per_mm=N"
            )
        values = values / table.steps_per_mm
    return _lengths(values, unit, table, m.strut_range, mechanisms.kinematics_of(m).home_values(m))


def _of_axes(
    values: Floats, stated: list[str | None], table: ForeignTable, m: Commanded
) -> tuple[Floats, ForeignTable, tuple[str, ...]]:
    """((n, axes) rad and m, ForeignTable, sentences) of axes that turn and slide: each column in the unit of its
    header, or in that stated for the table; others in SI, or in degrees and mm where SI is beyond their travel.
    Angles of a machine without slides that fit in both are refused.
    """
    q, ranges, remarks = values.copy(), mechanisms.kinematics_of(m).travel_ranges(m), []
    kinds = mechanisms.axis_units(m)
    if table.unit is not None and table.unit not in (*ANGLES, *LENGTHS):
        raise RigError(f"{table.file}: {table.unit} is not a unit of angles or lengths of axes")
    if table.unit is not None and not any(table.unit in (ANGLES if si == "rad" else LENGTHS) for si in kinds):
        raise RigError(f"{table.file}: {table.unit} is a unit of none of {', '.join(m.axes)}: {', '.join(kinds)}")
    for si, known, usual, word in (("rad", ANGLES, "deg", "turns"), ("m", LENGTHS, "mm", "slides")):
        own = [i for i, unit in enumerate(kinds) if unit == si]
        units = {i: table.unit if table.unit in known else stated[i] for i in own}
        for i, unit in units.items():
            if unit is not None and unit not in known:
                raise RigError(
                    f"{table.file}: {unit} is not a unit of {m.axes[i]}, which {word}; there are {', '.join(known)}"
                )
        open_ = [i for i, unit in units.items() if unit is None]
        if open_:
            found = _unit_within_travel(q[:, open_], ranges[open_], table, (si, usual), "m" not in kinds)
            units |= dict.fromkeys(open_, found)
            if "m" not in kinds or found == usual:
                what, limits = ("angles", "joints'") if si == "rad" else ("slides", "slides'")
                remarks.append(
                    f"{table.file.name}: {what} are in {found}, as they are beyond the {limits} limits otherwise"
                )
            if len(open_) == len(m.axes):
                table = replace(table, unit=found)
        for i, unit in units.items():
            q[:, i] /= known[unit or si]
    return q, table, tuple(remarks)


def _unit_within_travel(
    values: Floats, ranges: Floats, table: ForeignTable, units: tuple[str, str], refuses_both: bool
) -> str:
    """The one of two units in which values (n, k) lie within their travel (k, 2), of both the first. Raises RigError
    for none, and where both are refused.
    """
    per = {**ANGLES, **LENGTHS}
    fit = [unit for unit in units if fits_ranges_within_a_tenth(values / per[unit], ranges)]
    what = "angles" if units[0] == "rad" else "slides"
    message = f"{what} run from {values.min():.6g} to {values.max():.6g}"
    if len(fit) > 1 and refuses_both:
        raise ambiguity_error(
            f"{table.file}: the unit of its {what} is not stated, {message}, both within the limits of rig.toml",
            [(f"up to {np.abs(values).max():.4g} {unit}", f"commands.unit={unit}") for unit in fit],
        )
    if not fit:
        raise RigError(
            f"{table.file}: {message}, which is beyond the limits in rig.toml in {units[0]} and in {units[1]}; --set "
            f"commands.unit={units[1]} states one, or a header as q1 [{units[1]}]"
        )
    return fit[0]


def _lengths(
    values: Floats, unit: str | None, table: ForeignTable, ranges: Floats, home: Floats
) -> tuple[Floats, ForeignTable, tuple[str, ...]]:
    requested = ("mm",) if unit == "steps" else tuple(LENGTHS) if unit is None else (unit,)
    fit = likely_length_units_and_zeros(
        values, ranges, home, requested, ("zero", "home") if table.relative is None else (table.relative,)
    )
    better = [(u, r) for u, r in fit if is_likely_length_unit(values, ranges, u, r)]
    fit = better if len(better) == 1 else fit
    message = (
        f"{table.file}: lengths run from {values.min():.6g} to {values.max():.6g}{' mm' if unit == 'steps' else ''}, "
        f"and rig.toml's strut_range is {ranges.min():.6g} to {ranges.max():.6g} m"
    )
    names = {"zero": "joint to joint", "home": "from home"}
    if len(fit) > 1 and {u for u, _ in fit} - {fit[0][0]}:
        raise ambiguity_error(
            f"{message}: they fit in several units", [(f"{u}, {names[r]}", f"commands.unit={u}") for u, r in fit]
        )
    if len(fit) > 1:
        raise ambiguity_error(f"{message}: they fit both ways", [(names[r], f"commands.relative={r}") for _, r in fit])
    if not fit and (unit is None or table.relative is None):
        raise RigError(
            f"{message}: they fit in no unit, neither joint to joint nor from home; look at strut_range and "
            "home, or state both: "
            "--set commands.unit=mm --set commands.relative=zero"
        )
    u, r = fit[0] if fit else (requested[0], table.relative or "zero")
    q = values / LENGTHS[u] + (home if r == "home" else 0.0)
    remarks = (
        ()
        if unit and table.relative
        else (
            f"{table.file.name}: lengths are in {'steps' if unit == 'steps' else u}, {names[r]}"
            f"{'' if unit else ', as within strut_range and about its size in no other'}",
        )
    )
    return q, replace(table, unit=unit or u, relative=r), remarks


def _pace(values: Floats, design: Design) -> Callable[[Floats], bool]:
    """Whether the axes can move as times t (n,) s would have it."""
    unit = design.mechanism.axis_unit
    top = design.actuator.max_speed if unit == "m" else None
    low, high = (SLOWEST * top, FASTEST * top) if top else USUAL[unit]

    def plausible(t: Floats) -> bool:
        later = np.diff(t) > 0  # rows that repeat a time or go back are named once the unit is known
        step = np.abs(np.diff(values, axis=0)).max(axis=1)[later] / np.diff(t)[later]
        return bool((step > 0).any()) and low <= float(np.quantile(step[step > 0], 0.9)) <= high

    return plausible
