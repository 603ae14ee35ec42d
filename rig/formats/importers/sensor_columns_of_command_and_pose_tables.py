"""Columns of tables of commands and poses that are neither.

Temperatures and payloads among them become channels of sensors.csv; all others are named.
"""

import shlex
from dataclasses import dataclass, replace
from decimal import Decimal

from rig.errors import FileError
from rig.formats.importers.foreign_command_table import ImportedCommands
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import ForeignTable, Recipe
from rig.formats.importers.foreign_pose_table import ImportedPoses
from rig.formats.importers.foreign_sensor_table import (
    ImportedSensors,
    is_temperature_or_payload,
    read_sensors,
    sensor_channels,
)
from rig.formats.importers.foreign_table_column_search_and_completion import Cells
from rig.formats.importers.imported_frame_times_from_names_tables_or_commands import Like
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism


@dataclass(frozen=True, slots=True)
class _Shared:
    """A table of commands, of poses or of both. section : of it in a recipe; table : as it was read; used : headers
    that are commands, poses or their times; times : exact s of its rows, or None where rows are not in order of these
    """

    section: str
    table: ForeignTable
    used: frozenset[str]
    times: list[Decimal] | None


def sensors_and_unread_columns(
    recipe: Recipe,
    at: dict[int, Decimal],
    commanded: ImportedCommands | None,
    posed: ImportedPoses | None,
    mechanism: Mechanism,
    are_plausible: Like,
) -> tuple[ImportedSensors | None, tuple[str, ...]]:
    """(ImportedSensors of the recipe's table of sensors, else of temperatures and payloads in its tables of commands
    and poses, or None; sentences on columns that nothing reads).

    at : {frame: exact s}; are_plausible : whether times (n,) s from the first can be so
    Raises RigError for what cannot be used
    """
    shared = [] if recipe.bag is not None else _shared_tables(at, commanded, posed)
    stated, logged, lines = recipe.sensors, None, []
    own = next((one for one in shared if stated is not None and one.table.file == stated.file), None)
    if stated is not None and own is None:
        logged = read_sensors(stated, are_plausible, mechanism)
    for one in sorted(shared, key=lambda one: one is not own):  # the stated one first
        columns = () if stated is None or one is not own else stated.columns
        found, left = _channels(one, columns, mechanism, logged is None)
        logged = found or logged
        if left:
            where = "" if len(shared) == 1 else f"--sensors {shlex.quote(str(one.table.file))} "
            name = next(iter(left))
            lines.append(
                f"{one.table.file.name}: not read: {', '.join(h + why for h, why in left.items())}; "
                f"{where}--set {shlex.quote(f'sensors.columns.NAME={name}')} logs a column as a sensor channel NAME"
            )
    return logged, tuple(lines)


def _shared_tables(
    at: dict[int, Decimal], commanded: ImportedCommands | None, posed: ImportedPoses | None
) -> list[_Shared]:
    """The tables of commands and of poses, once where both are one."""
    tables = []
    if posed is not None:
        frames = [] if posed.frame is None else posed.frame.astype(int).tolist()
        tables.append(_Shared("poses", posed.table, _headers(posed.table), [at[k] for k in frames]))
    if commanded is not None:
        if posed is not None and posed.table.file == commanded.table.file:
            return [replace(tables[0], used=tables[0].used | _headers(commanded.table))]
        tables.append(_Shared("commands", commanded.table, _headers(commanded.table), commanded.t))
    return tables


def _headers(table: ForeignTable) -> frozenset[str]:
    return frozenset(header for _, header in table.columns)


def _channels(
    one: _Shared, columns: tuple[tuple[str, str], ...], mechanism: Mechanism, is_wanted: bool
) -> tuple[ImportedSensors | None, dict[str, str]]:
    """(ImportedSensors of a table, or None; {header: why} of the columns that are not read).

    columns : that are stated to be channels; is_wanted : whether channels are read of it
    """
    cells = read_foreign_table_header_and_cells(one.table, one.section)
    stated = {header for name, header in columns if name != "t"}
    odd = next((header for header in stated if header not in cells.header), None)
    if odd is not None:
        raise FileError(cells.path, f"has no column {odd}; its header is {', '.join(cells.header)}")
    wanted, left = [], dict[str, str]()
    for k, header in enumerate(cells.header):
        problem = _problem(cells, k, one.times) if header in stated or header not in one.used else None
        if header in stated and problem is not None:
            raise FileError(cells.path, f"column {header} cannot be a sensor channel: {problem}")
        is_own = is_temperature_or_payload(header)
        if header in stated or header not in one.used and is_wanted and problem is None and is_own:
            wanted.append(k)
        elif header not in one.used:
            left[header] = f" ({problem})" if problem is not None and is_own else ""
    if not wanted or one.times is None:
        return None, left
    first = {t: row for row, t in reversed(list(enumerate(one.times)))}  # hands are measured at one time
    times = sorted(first)
    found, retained, lines = sensor_channels(
        replace(cells, table=replace(one.table, columns=columns)), wanted, mechanism, is_own_table=False
    )
    channels = tuple((name, values[[first[t] for t in times]]) for name, values in found)
    table = ForeignTable(
        one.table.file,
        one.table.separator,
        one.table.decimal,
        header=one.table.header,
        period=one.table.period,
        columns=retained,
    )
    line = f"{cells.path.name}: sensor channels beside the poses or commands: {', '.join(name for name, _ in found)}"
    return ImportedSensors(times, channels, table, (line, *lines)), left


def _problem(cells: Cells, at: int, times: list[Decimal] | None) -> str | None:
    """Why a column cannot be a channel, or None."""
    if times is None or len(times) != len(cells.rows):
        return "there is not one time for each of its rows"
    try:
        cells.numbers(at)
    except FileError as error:
        return f"line {error.line} has no number"
    return None
