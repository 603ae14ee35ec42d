"""Sensor table of another program: channel names, temperatures in C, masses in kg."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import partial
from typing import cast

import numpy as np

from rig.array_types import Floats
from rig.errors import RigError
from rig.formats.checked_entries import name_problem
from rig.formats.importers.csv_dialect import read_foreign_table
from rig.formats.importers.foreign_table_columns import TIME, find_columns
from rig.formats.importers.import_recipe import ForeignTable
from rig.formats.importers.units_and_timestamps import LENGTHS, split_header


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
    said: tuple[str, ...]


def read_sensors(table: ForeignTable, are_plausible: Callable[[Floats], bool]) -> ImportedSensors:
    """Read the sensor channels of a foreign table. Raises RigError for unusable ones.
    are_plausible : whether times (n,) s from the first can be so. Raises RigError for what cannot be used
    """
    cells = read_foreign_table(table, "sensors")
    stated = {header: ours for ours, header in table.columns if ours != "t"}
    found = find_columns(cells, "sensors", TIME, ("t",))
    read_times = cells.times(found["t"], "sensors", table, are_plausible)
    kept, renamed = [("t", cells.header[found["t"]])], []
    channels: list[tuple[str, Floats]] = []
    for at, header in enumerate(cells.header):
        if at == found["t"]:
            continue
        unit = cells.unit(at)
        name = stated.get(header) or _name(header, unit)
        if name_problem(name):
            raise RigError(f"{table.file}: column {name_problem(name)}; --set 'sensors.columns.NAME={header}' names it")
        if name in dict(channels) or name == "t":
            raise RigError(
                f"{table.file}: two columns would be {name}; --set 'sensors.columns.NAME={header}' names one of them"
            )
        channels.append(
            (name, TO_SI.get(unit or "", cast(Callable[[Floats], Floats], lambda v: v))(np.array(cells.numbers(at))))
        )
        kept.append((name, header))
        if name != header:
            converted = unit in TO_SI and unit not in ("C", "kg", "m")
            renamed.append(f"{header} is {name}" + (f", from {unit}" if converted else ""))
    said = (f"{table.file.name}: {'; '.join(renamed)}",) if renamed else ()
    return ImportedSensors(
        read_times.seconds,
        tuple(channels),
        replace(cells.table, columns=tuple(kept), time_unit=read_times.unit, zone=read_times.zone),
        (*cells.said, *read_times.said, *said),
    )


def _name(header: str, unit: str | None) -> str:
    """A channel's name out of a header: words joined, its unit as a recording has it behind it."""
    bare = split_header(header)[0] if unit else header
    name = re.sub(r"[^A-Za-z0-9.-]+", "_", bare).strip("_.-")
    if unit in SI:
        known = re.fullmatch(r"(?i)(ambient|strut_?[1-6]|camera_.+)_temp(erature)?", name)
        if known:
            name = f"{known[1].lower() if not name.lower().startswith('camera') else known[1]}_temperature".replace(
                "strut_", "strut"
            )
        elif re.fullmatch(r"(?i)payload(_mass)?", name):
            name = "payload_mass"
        name = f"{name}_{SI[unit]}"
    return name
