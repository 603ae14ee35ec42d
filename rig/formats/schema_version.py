"""Which schema a file of ours has: one that is known here, one of a newer rig, or something else."""

import re
from collections.abc import Sequence
from pathlib import Path

from rig.errors import FileError

NAMED = re.compile(r"([a-z_]+)/([1-9][0-9]{0,8})")
MOST = 80  # characters of what a file names that are shown


def require_schema(
    path: Path | str,
    what: str,
    found: object,
    known: Sequence[str],
    place: tuple[int | None, int | None] = (None, None),
) -> None:
    """Raise FileError where a file does not name a known schema.

    what : the file should be, as in "calibration"; found : whatever it names; known : as "calibration/1", the oldest
        first; place : line and column
    """
    if found in known:
        return
    shown, names = repr(found)[:MOST], " or ".join(f'"{schema}"' for schema in known)
    latest = {one[1]: int(one[2]) for schema in known if (one := NAMED.fullmatch(schema))}
    named = NAMED.fullmatch(found) if isinstance(found, str) else None
    if named and int(named[2]) > latest.get(named[1], int(named[2])):
        raise FileError(
            path,
            f"was written by a newer rig: its schema is {shown}, and this one reads {names}; install the newer one",
            *place,
        )
    raise FileError(path, f"is no {what}: its schema is {shown}, not {names}", *place)
