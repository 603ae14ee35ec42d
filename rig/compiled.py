"""Where compiled kernels are kept: beside their sources, and where the installation cannot be written, in a folder of the user's own."""

import os
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path

HERE = Path(__file__).parent


def keep_kernels() -> None:
    """Tell numba, before it is imported, where to keep what it compiles, unless its user or the installation has a place for it."""
    folder = kernel_folder()
    if folder is not None:
        os.environ.setdefault("NUMBA_CACHE_DIR", str(folder))


@cache
def kernel_folder() -> Path | None:
    """The folder for compiled kernels, or None where they lie beside their sources.

    Kernels are loaded as code: a folder among temporary files is taken only where it is this user's alone.
    """
    kept = HERE / "__pycache__"
    if os.access(kept if kept.is_dir() else HERE, os.W_OK):
        return None
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    try:
        folder = Path(home) / "rig"
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass  # no home, or one that cannot be written: the next place is tried
    folder = Path(tempfile.gettempdir()) / f"rig-kernels-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700)
        _say(f"what is compiled is kept in {folder}: neither {HERE.parent} nor {home} can be written")
    except FileExistsError:
        there = folder.lstat()
        if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.getuid() or there.st_mode & 0o077:
            folder = Path(tempfile.mkdtemp(prefix="rig-kernels-"))
            _say(f"what is compiled is kept in {folder}, for this run: NUMBA_CACHE_DIR names a place to keep it")
    return folder


def _say(text: str) -> None:
    print(f"rig: {text}", file=sys.stderr)
