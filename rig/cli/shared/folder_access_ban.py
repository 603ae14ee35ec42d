"""A folder that this process may not look into: what keeps a diagnosis from the truth of its case."""

import os
import sys
from pathlib import Path

WATCHED = (
    "open",
    "os.listdir",
    "os.scandir",
    "os.rename",
    "os.link",
    "os.symlink",
    "shutil.copyfile",
)  # events whose first argument is a path


def forbid_folder(folder: str | Path) -> None:
    """From now on reading anything in a folder raises PermissionError in this process (PEP 578; it cannot be taken
    back).
    """
    closed = os.path.realpath(folder)

    def watch(event: str, given: tuple) -> None:
        if event in WATCHED and given and isinstance(given[0], (str, bytes, os.PathLike)):
            path = os.path.realpath(os.fsdecode(given[0]))
            if path == closed or path.startswith(closed + os.sep):
                raise PermissionError(f"{path} is withheld from this process")

    sys.addaudithook(watch)
