"""Locks of files and folders between processes.

A lock ends with the process that holds it, however that ends.

Where the system locks open files and folders themselves (flock), nothing is left behind and every user is kept out.
Elsewhere (Windows) a lock is a file in the user's temporary folder, named by what it locks.
"""

import errno
import hashlib
import os
import tempfile
from pathlib import Path
from typing import Protocol

try:
    import fcntl
except ImportError:  # Windows
    FLOCK = False
else:
    FLOCK = True

UNLOCKED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)  # file systems that know no locks


class HeldLock(Protocol):
    """A lock that this process holds."""

    def close(self) -> None:
        """Release it."""


class _OpenFolder:
    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def close(self) -> None:
        os.close(self._descriptor)


class _LockFile:
    """A lock file, held. Raises BlockingIOError where another process holds it and `wait` is false."""

    def __init__(self, path: Path, wait: bool) -> None:
        import filelock

        self._lock = filelock.FileLock(_lock_file(path), is_singleton=False, thread_local=False)
        try:
            self._lock.acquire(timeout=-1 if wait else 0)
        except filelock.Timeout:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from None

    def close(self) -> None:
        self._lock.release()


def lock_folder(folder: Path, wait: bool) -> HeldLock:
    """Lock a folder.

    On a file system that knows no locks nobody is kept out.
    Raises BlockingIOError where another process holds it and `wait` is false, OSError where the folder cannot be opened
    """
    if not FLOCK:
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))
        return _LockFile(folder, wait)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        if error.errno not in UNLOCKED:
            os.close(descriptor)
            raise
    return _OpenFolder(descriptor)


def lock_open_file(descriptor: int, path: Path) -> HeldLock | None:
    """Lock an open file at a path.

    None where the lock ends as the descriptor is closed.
    Raises OSError where another process holds it, or it cannot be locked.
    """
    if not FLOCK:
        return _LockFile(path, wait=False)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return None


def _lock_file(path: Path) -> Path:
    folder = Path(tempfile.gettempdir()) / "rig-locks"
    folder.mkdir(mode=0o700, exist_ok=True)
    name = os.path.normcase(os.path.realpath(path))
    return folder / hashlib.sha256(os.fsencode(name)).hexdigest()[:32]


def sync_folder(folder: Path) -> None:
    """Sync a folder's entries to disk, where its system and its file system support that.
    Raises OSError for a folder that cannot be opened.
    """
    if hasattr(os, "O_DIRECTORY"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            sync_open_folder(descriptor)
        finally:
            os.close(descriptor)


def sync_open_folder(descriptor: int) -> None:
    """Sync an open folder's entries to disk, where its file system supports that."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EROFS):
            raise
