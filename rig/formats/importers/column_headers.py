"""Column headers of foreign tables: which column holds what, by usual names or as stated."""

import re
from collections.abc import Iterable

from rig.errors import FileError, RigError
from rig.formats.importers.csv_dialect import Cells
from rig.formats.importers.import_recipe import ForeignTable
from rig.formats.importers.units_and_timestamps import split_header
from rig.formats.input_files import short_repr

TIME = (
    "t",
    "time",
    "timestamp",
    "stamp",
    "zeit",
    "zeitstempel",
    "uhrzeit",
    "elapsed",
    "elapsedtime",
    "epoch",
    "datetime",
    "utc",
    "unixtime",
    "clock",
)
FRAME = ("frame", "index", "nr", "no", "number", "i", "id", "bild", "n", "pose", "point")
IMAGE = ("image", "file", "filename", "img", "picture", "path")
CAMERA = ("camera", "cam", "kamera")
LIMB = ("l", "leg", "strut", "length", "actuator", "act", "axis", "limb", "bein", "m", "pos")
JOINT = ("q", "joint", "j", "theta", "axis", "a", "angle")


def _normalised_header(header: str) -> str:
    """A header's name without its unit, capitals and punctuation: what is compared."""
    return re.sub(r"[^a-z0-9]+", "", split_header(header)[0].lower())


def axis_header_names(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """{axis: accepted header names} for the axes l1.. or q1.."""
    return {name: tuple(f"{word}{name[1:]}" for word in (LIMB if name[0] == "l" else JOINT)) for name in names}


def find_columns(
    cells: Cells, section: str, header_names: dict[str, tuple[str, ...]], required_names: Iterable[str]
) -> dict[str, int]:
    """Columns found by their headers: {our name: column index}.

    header_names : {our name: what a header may be called}; required_names : that must be there. Raises RigError for
        what is missing or there twice
    """
    stated = dict(cells.table.columns)
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
            k
            for k, header in enumerate(cells.header)
            if _normalised_header(header) in names and header not in stated.values()
        ]
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
    missing = [ours for ours in required_names if ours not in found]
    if missing:
        raise RigError(
            f"{cells.path}: no column is {missing[0]}: the header is {', '.join(cells.header)}; state which "
            "one it is with "
            f"--set '{section}.columns.{missing[0]}=HEADER'"
        )
    return found


def recipe_columns(table: ForeignTable, cells: Cells, found: dict[str, int]) -> tuple[tuple[str, str], ...]:
    """The columns found, in the form that an import recipe stores."""
    return tuple((ours, cells.header[at]) for ours, at in found.items())
