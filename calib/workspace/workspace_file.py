"""A workspace as files hold it: a part of calibration.json, and a table of its cells."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from calib.workspace.workspace_cells import Workspace
from rig.formats.checked_entries import Entries

SCHEMA = "workspace/1"
COLUMNS = ("x", "y", "z", "size", "believed", "lost", "reached", "gained", "room", "singular", "bound_m", "bound_rad")
COUNTED = ("believed", "lost_in", "reached", "gained_in")


def workspace_dict(w: Workspace) -> dict[str, Any]:
    """dict of a Workspace, as JSON holds it; what is not known is null."""
    tree = {part.name: getattr(w, part.name) for part in fields(w)}
    return {"schema": SCHEMA} | {
        name: _plain(value) if isinstance(value, np.ndarray) else value for name, value in tree.items()
    }


def _plain(values: np.ndarray) -> list[Any]:
    known = values.astype(object)
    known[values != values] = None
    return list(known.tolist())


def workspace_from_entries(table: Entries) -> Workspace:
    """Workspace of what `workspace_dict` gave, as Entries. Raises FileError for anything else."""
    table.text("schema", (SCHEMA,))
    index = _whole(table, "index", (None, 3))
    cells = len(index)
    if not cells:
        table.fail(f"{table.name('index')} must list one cell at the least", "index")
    lost, gained = (
        None if table.get(name) is None else table.number(name, least=0.0, most=1.0) for name in ("lost", "gained")
    )
    believed, lost_in, reached, gained_in = (_whole(table, name, (cells,)) for name in COUNTED)
    return Workspace(
        table.whole("drawn", 1),
        lost,
        gained,
        table.array("origin", (3,)),
        table.number("size", above=0.0),
        index,
        believed,
        lost_in,
        reached,
        gained_in,
        table.array("room", (cells,), nulls=True),
        table.array("singular", (cells,), nulls=True),
        table.array("bound", (cells, 2), nulls=True),
    )


def _whole(table: Entries, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Numbers of a shape that count, from 0."""
    values = table.array(name, shape)
    if (values < 0).any() or (values != np.floor(values)).any():
        table.fail(f"{table.name(name)} must hold whole numbers from 0", name)
    return values.astype(int)


def workspace_rows(w: Workspace) -> Iterator[str]:
    """The lines of a table of COLUMNS, one for each cell: its middle and edge in m, counts of configurations, the rest
    as in Workspace.
    """
    for place, counts, room, singular, bound in zip(
        w.centre, zip(*(getattr(w, name) for name in COUNTED)), w.room, w.singular, w.bound
    ):
        numbers = (
            *(f"{value:.6f}" for value in (*place, w.size)),
            *map(str, counts),
            *(_number(value) for value in (room, singular, *bound)),
        )
        yield ",".join(numbers)


def _number(value: float) -> str:
    return f"{value:.6g}" if value == value else ""
