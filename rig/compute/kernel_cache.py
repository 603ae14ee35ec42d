"""Where compiled kernels are kept: beside their sources, and where that cannot be, in a folder of the user's own. They
are loaded as code.
"""

import os
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path

HERE = Path(__file__).parents[1]


def keep_kernels() -> None:
    """Tell numba, before it is imported, where to keep what it compiles, unless its user or the installation has a
    place for it.
    """
    folder = kernel_folder()
    if folder is not None:
        os.environ.setdefault("NUMBA_CACHE_DIR", str(folder))


@cache
def kernel_folder() -> Path | None:
    """The folder for compiled kernels, or None where they lie beside their sources."""
    kept = HERE / "__pycache__"
    return (
        None if os.access(kept if kept.is_dir() else HERE, os.W_OK) else own_folder(f"{HERE.parent} cannot be written")
    )


def trusted_folder(folder: Path) -> Path:
    """The folder itself where nobody but this user and root can write to it, else `own_folder`."""
    return folder if is_private(folder) else own_folder(f"others can write to {folder}")


@cache
def is_private(folder: Path) -> bool:
    """Whether nobody but this user and root can put a file into a folder, or where it is not there yet, into the
    nearest one above; nor put another folder in its place."""
    found = Path(os.path.realpath(folder))
    there = [place.stat() for place in (found, *found.parents) if place.exists()]
    own = there[0].st_uid in (0, os.getuid()) and not there[0].st_mode & 0o022
    return own and not any(above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX for above in there[1:])


@cache
def own_folder(reason: str) -> Path:
    """A folder for compiled kernels that is this user's alone: below the home, or else among temporary files.
    reason : why it is needed
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    why = "cannot be written"
    try:
        folder = Path(home) / "rig"
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if os.access(folder, os.W_OK):
            if is_private(folder):
                return folder
            why = "can be written to by others"
    except OSError:
        pass  # no home, or one that cannot be written: the next place is tried
    folder = Path(tempfile.gettempdir()) / f"rig-kernels-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700)
        _say(f"what is compiled is kept in {folder}: {reason}, and {home} {why}")
    except FileExistsError:
        there = folder.lstat()
        if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.getuid() or there.st_mode & 0o077:
            folder = Path(tempfile.mkdtemp(prefix="rig-kernels-"))
            _say(f"what is compiled is kept in {folder}, for this run: NUMBA_CACHE_DIR names a place to keep it")
    return folder


def _say(text: str) -> None:
    print(f"rig: {text}", file=sys.stderr)
