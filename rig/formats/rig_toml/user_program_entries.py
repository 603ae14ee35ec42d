"""Programs of the user's own that rig.toml names: a file, whose path is relative to rig.toml, or a package's entry.

Reading a rig.toml runs none of them: only what drives the controller or opens the camera does.
"""

import re
from pathlib import PurePosixPath

from rig.formats.checked_entries import Entries

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")  # of a package's entry point


def user_program_text(table: Entries, key: str, stated: str) -> str:
    """A stated "file:PATH" with PATH joined to the folder of rig.toml, or "package:NAME" as it is. Raises FileError."""
    kind, _, place = stated.partition(":")
    if kind == "package":
        if not NAME.fullmatch(place):
            table.fail(f"{table.name(key)}: expected package:NAME, an entry point's name, not {stated!r}", key)
        return stated
    path = PurePosixPath(place)
    if path.is_absolute() or path.suffix != ".py" or not place.isprintable():
        table.fail(
            f"{table.name(key)}: expected file:NAME.py, a path relative to this file's folder, not {stated!r}",
            key,
            value=stated,
        )
    return f"{kind}:{table.file.parent / path}"
