"""Foreign tables of sensors.

Read into a recording's sensors.csv; names of channels out of headers.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import partial
from typing import cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import rig_part_name_problem
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.importers.foreign_table_column_search_and_completion import (
    JOINT,
    LIMB,
    TIME,
    Cells,
    column_indices_by_headers,
)
from rig.formats.importers.foreign_table_units_and_timestamps import header_name_and_unit
from rig.formats.numbers_and_units import LENGTHS
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, has_struts


def _over(per: float, values: Floats) -> Floats:
    return values / per


TO_SI: dict[str, Callable[[Floats], Floats]] = {
    "C": lambda v: v,
    "K": lambda v: v - 273.15,
    "F": lambda v: (v - 32) / 1.8,
    "kg": lambda v: v,
    "g": lambda v: v / 1000,
    **{unit: partial(_over, per) for unit, per in LENGTHS.items()},
}
SI = {"C": "C", "K": "C", "F": "C", "kg": "kg", "g": "kg"}


@dataclass(frozen=True, slots=True, eq=False)
class ImportedSensors:
    """t : n exact s; channels : pairs (name, (n,) values)."""

    t: list[Decimal]
    channels: tuple[tuple[str, Floats], ...]
    table: ForeignTable
    remarks: tuple[str, ...]


def read_sensors(table: ForeignTable, are_plausible: Callable[[Floats], bool], mechanism: Mechanism) -> ImportedSensors:
    """Read the sensor channels of a foreign table.

    are_plausible : whether times (n,) s from the first can be so; mechanism : whose struts a temperature may be of
    Raises RigError for what cannot be used.
    """
    cells = read_foreign_table_header_and_cells(table, "sensors")
    found = column_indices_by_headers(cells, "sensors", TIME, ("t",))
    read_times = cells.times(found["t"], "sensors", table, are_plausible)
    channels, retained, lines = sensor_channels(
        cells, [k for k in range(len(cells.header)) if k != found["t"]], mechanism, is_own_table=True
    )
    return ImportedSensors(
        read_times.seconds,
        channels,
        replace(
            cells.table,
            columns=(("t", cells.header[found["t"]]), *retained),
            time_unit=read_times.unit,
            zone=read_times.zone,
        ),
        (*cells.remarks, *read_times.remarks, *lines),
    )


Channels = tuple[tuple[str, Floats], ...]  # (name, (n,) values) pairs


def sensor_channels(
    cells: Cells, columns: Sequence[int], mechanism: Mechanism, is_own_table: bool
) -> tuple[Channels, tuple[tuple[str, str], ...], tuple[str, ...]]:
    """(channels, pairs (name, header), sentences) of some columns of a table that are sensor channels.

    columns : indices; mechanism : whose axes a temperature may be of; is_own_table : whether the table is of sensors
    alone, not of commands or poses
    Raises RigError for what cannot be a channel.
    """
    stated = {header: [ours for ours, other in cells.table.columns if other == header] for header in cells.header}
    channels: list[tuple[str, Floats]] = []
    retained, renamed = [], []
    names_of = _channel_names([cells.header[at] for at in columns], mechanism, is_own_table)
    for at in columns:
        header, unit = cells.header[at], cells.unit(at)
        is_in_gravities = is_acceleration_in_gravities(header) and not any(n.endswith("_kg") for n in stated[header])
        unit = None if is_in_gravities else unit
        values = TO_SI.get(unit or "", cast(Callable[[Floats], Floats], lambda v: v))(np.array(cells.numbers(at)))
        names = stated[header] or names_of[header]
        for name in names:
            if rig_part_name_problem(name):
                raise RigError(
                    f"{cells.path}: column {rig_part_name_problem(name)}; --set 'sensors.columns.NAME={header}' names "
                    "it"
                )
            if name in dict(channels) or name == "t":
                raise RigError(
                    f"{cells.path}: two columns would be {name}; --set 'sensors.columns.NAME={header}' names one of "
                    "them"
                )
            channels.append((name, values))
            retained.append((name, header))
        if is_in_gravities:
            renamed.append(f"{header} is {', '.join(names)}, not converted: g of an acceleration")
        elif names != [header]:
            converted = unit in TO_SI and unit not in ("C", "kg", "m")
            renamed.append(f"{header} is {', '.join(names)}" + (f", from {unit}" if converted else ""))
    lines = (f"{cells.path.name}: {'; '.join(renamed)}",) if renamed else ()
    return tuple(channels), tuple(retained), lines


TEMPERATURE = r"(t|temp|temperatur|temperature|temperatura)"
ROOM = r"(ambient|room|air|lab|laboratory|hall|raum|luft|umgebung|umgebungs|raumluft|halle|aire|ambiante|sala)"
MACHINE = r"(arm|robot|roboter|robotarm|machine|maschine|maschinen|machina|maquina|gantry|portal|hexapod|structure)"
ACCELERATION = r"(acc|accel|acceleration|accelerometer|beschleunigung|vib[a-z]*|schwingung|imu|shock)"
AMBIENT = "ambient_temperature_C"


def is_temperature_or_payload(header: str) -> bool:
    """Whether a header names a temperature or the payload's mass, by its unit."""
    unit = header_name_and_unit(header)[1]
    return SI.get(unit or "") == "C" or bool(unit in SI and re.fullmatch(r"(?i)payload(_mass)?", _joined(header)))


def is_acceleration_in_gravities(header: str) -> bool:
    """Whether a header's unit g is that of an acceleration, not grams: acc_x [g], ax [g], vibration 2 (g).

    >>> is_acceleration_in_gravities("acc_x [g]"), is_acceleration_in_gravities("payload [g]")
    (True, False)
    """
    if header_name_and_unit(header)[1] != "g":
        return False
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", _joined(header)).lower()
    is_named = any(re.fullmatch(rf"{ACCELERATION}[xyz]?[0-9]*", word) for word in re.split(r"[_.-]", split))
    return is_named or bool(re.fullmatch(r"[ag][_.-]?[xyz]", split))


def _joined(header: str) -> str:
    """A header's words without their unit, joined."""
    bare = header_name_and_unit(header)[0] if header_name_and_unit(header)[1] else header
    return re.sub(r"[^A-Za-z0-9.-]+", "_", bare).strip("_.-")


def _channel_names(headers: Sequence[str], mechanism: Mechanism, is_own_table: bool) -> dict[str, list[str]]:
    """{header: names} of channels. One temperature of the whole machine stands for the room's where none is logged:
    what effects of the whole machine follow. In a table of sensors alone one is of it by its name, as `arm temp [C]`.
    """
    names = {header: _names(header, header_name_and_unit(header)[1], mechanism, is_own_table) for header in headers}
    whole = rf"{TEMPERATURE}?{MACHINE}{TEMPERATURE}?" + ("" if is_own_table else r"|temp(eratur(e|a)?)?")
    of_machine = [
        header
        for header in headers
        if SI.get(header_name_and_unit(header)[1] or "") == "C"
        and re.fullmatch(whole, _joined(header).lower().replace("_", ""))
    ]
    if len(of_machine) == 1 and [AMBIENT] not in names.values():
        names[of_machine[0]] = [AMBIENT]
    return names


def _names(header: str, unit: str | None, mechanism: Mechanism, is_own_table: bool) -> list[str]:
    """Names of a channel out of a header: words joined, its unit as a recording has it behind it. A temperature of legs
    without a number is that of each strut; one of a joint or a slide that of the link behind it. Others' `temp` is
    spelt out in a table of commands or poses.
    """
    name = _joined(header)
    if is_acceleration_in_gravities(header):
        return [f"{name}_g"]
    if unit not in SI:
        return [name]
    word = name.lower().replace("_", "")
    struts = len(mechanism.axes) if has_struts(mechanism) else 0
    limb = re.fullmatch(rf"{TEMPERATURE}?({'|'.join(LIMB if struts else JOINT)})s?([1-9]?){TEMPERATURE}?", word)
    is_of_axis = limb is not None and bool(limb[1] or limb[4] or len(limb[2]) > 2)
    camera = re.fullmatch(rf"(?i)(camera_.+)_{TEMPERATURE}", name)
    short = re.fullmatch(rf"(?i)(.+)_{TEMPERATURE}", name)
    names = [name]
    if SI[unit] == "C" and re.fullmatch(rf"{TEMPERATURE}?{ROOM}{TEMPERATURE}?", word):
        names = ["ambient_temperature"]
    elif SI[unit] == "C" and struts and is_of_axis:
        own = range(1, struts + 1) if limb is None or not limb[3] else [int(limb[3])]
        names = [f"strut{i}_temperature" for i in own]
    elif SI[unit] == "C" and is_of_axis and limb and limb[3] and int(limb[3]) <= len(mechanism.axes):
        place = mechanisms.axis_place_texts(mechanism)[int(limb[3]) - 1]
        names = [f"{place.replace(' ', '')}_temperature"]
    elif camera:
        names = [f"{camera[1]}_temperature"]
    elif SI[unit] == "C" and short and not is_own_table:
        names = [f"{short[1]}_temperature"]
    elif re.fullmatch(r"(?i)payload(_mass)?", name):
        names = ["payload_mass"]
    return [f"{one}_{SI[unit]}" for one in names]
