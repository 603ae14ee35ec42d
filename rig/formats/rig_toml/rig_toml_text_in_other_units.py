"""Text of rig.toml in other units.

From m and rad, rewritten in the units that its owner reads ("mm, deg"), remarks included.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

from rig.array_and_json_types import Json
from rig.formats.checked_toml_and_json_entries import Key
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits, UnitNames
from rig.formats.rig_toml.arm_dynamics_entries import dynamics_of_table
from rig.formats.rig_toml.design_from_rig_toml import design_of_entries
from rig.formats.rig_toml.mechanism_entries import ROW_UNITS
from rig.model.mechanisms.mechanism_kinds_and_kinematics import axis_units, has_links

DIGITS = 10  # of a figure that is converted
REMARK = re.compile(r"(#\s+|\()(m|rad)(?=(/s(\^2)?)?( per revolution|,|\)|\s*$))")  # at its start, or in brackets


def rig_toml_in_units(text: str, units: LengthAndAngleUnits) -> str:
    """The text of a rig.toml with its lengths and angles in other units.

    Of one in m and rad; the units are stated.
    Figures are converted by the units that the reader of rig.toml asks for; layout and remarks remain.
    text : whose boards, if any, are listed markers
    Raises FileError where the text is no rig.toml, ValueError where it states units already, or a board
    """
    import tomlkit

    if units == SI:
        return text
    entries = toml_entries(text, Path("rig.toml"))
    if "units" in entries.tree or ("target" in entries.tree and any("board" in one for one in entries.tree["target"])):
        raise ValueError("expected a rig.toml in m and rad without boards")
    log: dict[tuple[Key, ...], UnitNames] = {}
    root = replace(entries, unit_log=log)
    mechanism = design_of_entries(root).mechanism
    if has_links(mechanism):
        dynamics_of_table(root.table("dynamics", optional=True), axis_units(mechanism))
    log.update(_units_of_joint_rows(entries.tree["mechanism"], ("mechanism",)))
    document: Any = tomlkit.parse("\n".join(_remark(line, units) for line in text.split("\n")))
    for path, unit in log.items():
        value = np.array(reduce(getitem, path, document), float)
        factors = np.broadcast_to(np.vectorize(units.per_si, otypes=[float])(np.array(unit)), value.shape)
        for index in map(tuple, np.argwhere(factors != 1).tolist()):
            above, key = (*path, *index)[:-1], (*path, *index)[-1]
            reduce(getitem, above, document)[key] = float(f"{value[index] * factors[index]:.{DIGITS}g}")
    for k, one in enumerate(mechanism.couplings if has_links(mechanism) else ()):
        joint, leader = (units.per_si(axis_units(mechanism)[k]) for k in (one.joint, one.leader))
        document["mechanism"]["coupling"][k]["multiplier"] = float(f"{one.multiplier * joint / leader:.{DIGITS}g}")
    schema = next(line for line in document.as_string().split("\n") if line.startswith("schema"))
    return document.as_string().replace(schema, f'{schema}\nunits = "{units}"', 1)


def _units_of_joint_rows(table: Json, path: tuple[Key, ...]) -> Iterator[tuple[tuple[Key, ...], str]]:
    """(path, SI unit) of each figure of the rows of an arm, or of the arms of a chain, that are written as lists."""
    stated: Json = {"stage": [], "joints": []} | table
    for i, stage in enumerate(stated["stage"]):
        yield from _units_of_joint_rows(stage, (*path, "stage", i))
    for i, row in enumerate(stated["joints"]):
        if isinstance(row, list):
            word = isinstance(row[0], str)
            for j, unit in enumerate(ROW_UNITS[: len(row) - word]):
                yield (*path, "joints", i, j + word), unit


def _remark(line: str, units: LengthAndAngleUnits) -> str:
    """A line with the units of its remark renamed."""
    code, mark, remark = line.partition("#")
    return code + REMARK.sub(lambda match: match[1] + units.name(match[2]), mark + remark)
