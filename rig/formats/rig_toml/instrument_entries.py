"""The [instrument] of a rig.toml: who wrote poses.csv, what of a pose it sees, and how well."""

import math
from dataclasses import fields

from rig.formats.checked_entries import Entries
from rig.model.design import Instrument

KINDS = ("pose", "orientation", "distance")


def instrument(table: Entries) -> Instrument:
    """Instrument of a table. Raises FileError for figures that are missing, implausible or of what its kind does not
    see.
    """
    table.refuse_misspelt([field.name for field in fields(Instrument)])
    kind = table.text("kind", KINDS, default="pose")
    for key, seen in (("position_sigma", kind != "orientation"), ("rotation_sigma", kind != "distance")):
        if key in table.tree and not seen:
            table.fail(
                f"an instrument of kind {kind!r} sees no "
                f"{'positions' if key == 'position_sigma' else 'rotations'}; leave out "
                f"{table.name(key)}",
                key,
            )
    position = table.number("position_sigma", above=0, most=1, unit="m") if kind != "orientation" else math.inf
    if kind == "orientation":
        rotation = table.number("rotation_sigma", above=0, most=1, unit="rad")
    else:
        rotation = table.number("rotation_sigma", None, above=0, most=1, unit="rad")
    return Instrument(
        table.text("base", ("free", "rig")), table.text("tool", ("free", "rig")), position, rotation, kind
    )
