"""Schema version of a file: accepted, written by a newer version, or of another kind."""

import re
from collections.abc import Sequence
from pathlib import Path

from rig.errors import FileError

NAMED = re.compile(r"([a-z_]+)/([1-9][0-9]{0,8})")
MOST = 80  # characters of what a file names that are shown


def require_schema(
    path: Path | str,
    file_kind: str,
    found_schema: object,
    known_schemas: Sequence[str],
    place: tuple[int | None, int | None] = (None, None),
) -> None:
    """Raise FileError unless a file's schema is one of the known schemas.

    file_kind : the file should be, as in "calibration"; found_schema : whatever it names; known_schemas : as
        "calibration/1", the oldest first; place : line and column
    """
    if found_schema in known_schemas:
        return
    shown, names = repr(found_schema)[:MOST], " or ".join(f'"{schema}"' for schema in known_schemas)
    latest = {one[1]: int(one[2]) for schema in known_schemas if (one := NAMED.fullmatch(schema))}
    named = NAMED.fullmatch(found_schema) if isinstance(found_schema, str) else None
    if named and int(named[2]) > latest.get(named[1], int(named[2])):
        raise FileError(
            path,
            f"was written by a newer rig: its schema is {shown}, and this one reads {names}; install the newer one",
            *place,
        )
    raise FileError(path, f"is no {file_kind}: its schema is {shown}, not {names}", *place)
