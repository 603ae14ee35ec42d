"""Atomic writing of files, and locks of files and folders between processes.

Files are written whole or not at all.

A lock ends with the process that holds it, however that ends. Where the system locks open files and folders themselves
(flock), nothing is left behind and every user is kept out. Elsewhere (Windows) a lock is a file in the user's temporary
folder, named by what it locks.
"""

import errno
import hashlib
import os
import re
import secrets
import stat
import sys
import tempfile
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Protocol

from rig.errors import FileError
from rig.formats.local_and_remote_input_files import BINARY

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
    """Sync a folder to disk.

    Its entries, where its system and its file system support that.
    Raises OSError for a folder that cannot be opened.
    """
    if hasattr(os, "O_DIRECTORY"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            sync_open_folder(descriptor)
        finally:
            os.close(descriptor)


def sync_open_folder(descriptor: int) -> None:
    """Sync an open folder to disk.

    Its entries, where its file system supports that.
    """
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EROFS):
            raise


STANDARD_OUTPUT = Path("/dev/stdout")  # what `-` stands for
NO_LINK: int = getattr(os, "O_NOFOLLOW", 0)  # O_EXCL alone follows none where that is missing
PART = ".rig-{}.part"  # name of a temporary; its length does not depend on the file's


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write a UTF-8 text file atomically.

    Raises as `write_bytes` does
    """
    try:
        data = text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise FileError(
            path,
            f"cannot be written: it would hold {text[max(error.start - 30, 0) : error.end]!r}, a name that "
            "is no UTF-8; "
            "rename that file or folder",
        ) from None
    write_bytes(path, data)


def write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write a file atomically and flush it to disk.

    Links are followed, a file that is there keeps its mode and owner. What is not a regular file (a device, a FIFO) and
    what this process's standard output or error goes to is written straight to. Raises FileError with path and reason
    where that cannot be done; what stood there then stands there still and no temporary is left.
    """
    try:
        status = path_status(path)
        own = _own_stream(status) if status is not None or Path(path) != STANDARD_OUTPUT else 1
        if status is not None and stat.S_ISDIR(status.st_mode):
            raise FileError(path, "is a folder, not a file to write")
        if own is not None:
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:  # a process may be started without
                    stream.flush()
            _all(own, data)
        elif status is not None and not stat.S_ISREG(status.st_mode):
            _straight(path, data)
        else:
            _replace(Path(os.path.realpath(path)), data, status)
    except BrokenPipeError:
        raise  # who read has gone away, which is no fault of the file
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None


def path_status(path: str | PathLike[str]) -> os.stat_result | None:
    """Status (stat) of what is at a path, or None for nothing.

    Links are followed.
    Raises OSError for what cannot be asked.
    """
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def is_path_written_without_staging(path: str | PathLike[str]) -> bool:
    """Whether a path is written directly, not atomically.

    A device, a pipe, or this process's standard output.
    """
    try:
        status = path_status(path)
    except OSError:
        return False
    return status is not None and (
        _own_stream(status) is not None or not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode))
    )


def _own_stream(status: os.stat_result | None) -> int | None:
    """1 or 2 where a file is what that descriptor goes to: renaming over it would leave the shell's redirection with a
    file nobody sees.
    """
    for descriptor in (1, 2):
        with suppress(OSError):  # a closed descriptor is nothing's
            if status is not None and os.path.samestat(status, os.fstat(descriptor)):
                return descriptor
    return None


def _straight(path: str | PathLike[str], data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | BINARY | getattr(os, "O_NOCTTY", 0))
    try:
        _all(descriptor, data)
    finally:
        os.close(descriptor)


def _replace(place: Path, data: bytes, status: os.stat_result | None) -> None:
    """Put data at a place that is no link. status : status of the regular file that it takes the place of, or None"""
    if status is not None and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    folder = _open_folder(place.parent)
    base = place.parent if folder is None else Path()
    part = base / PART.format(secrets.token_hex(8))
    try:
        mode = 0o666 if status is None else stat.S_IMODE(status.st_mode)
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_LINK | BINARY, mode, dir_fd=folder)
        try:
            try:
                if status is not None:
                    _alike(descriptor, status)
                _all(descriptor, data)
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            os.replace(part, base / place.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            os.unlink(part, dir_fd=folder)
            raise
        if folder is not None:
            sync_open_folder(folder)
    finally:
        if folder is not None:
            os.close(folder)


def _open_folder(folder: Path) -> int | None:
    """A folder held open, so that none that takes its place meanwhile is written to; None where the system opens no
    folders.
    """
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY) if os.open in os.supports_dir_fd else None


def _alike(descriptor: int, status: os.stat_result) -> None:
    """Give a new file the owner and the mode of the one whose place it takes; who is not root makes files of his own
    only.
    """
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        os.fchown(descriptor, status.st_uid, status.st_gid)
    if hasattr(os, "fchmod"):  # elsewhere (Windows) a mode says no more than whether a file may be written
        os.fchmod(descriptor, stat.S_IMODE(status.st_mode))


def _all(descriptor: int, data: bytes) -> None:
    """Write all of data; to a terminal, what of it would do more than be shown is escaped."""
    if os.isatty(descriptor):
        data = escape_unprintable(data.decode("utf-8", "surrogateescape")).encode("utf-8")
    rest = memoryview(data)
    while len(rest):
        rest = rest[os.write(descriptor, rest) :]


UNSEEN = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]|\r(?!\n)"
)


def escape_unprintable(text: str) -> str:
    """Text with unprintable characters escaped.

    Control and direction characters, invalid UTF-8.
    """
    return UNSEEN.sub(_escape, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found.group())
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name, as Python holds it
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
