"""Bytes and text of outside files: regular files alone, of a size that can be meant; every failure is a FileError."""

import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from rig.errors import FileError
from rig.formats import remote_folders

LARGEST = 1 << 28  # bytes of a text file
SHOWN = 80  # characters of a value that a message repeats
KINDS = (
    (stat.S_ISDIR, "is a folder, not a file"),
    (stat.S_ISFIFO, "is a pipe, not a file"),
    (stat.S_ISCHR, "is a device, not a file"),
    (stat.S_ISBLK, "is a device, not a file"),
    (stat.S_ISSOCK, "is a socket, not a file"),
)


def open_file(path: Path, missing: str = "no such file") -> BinaryIO:
    """A regular file, opened to be read; anything else is never waited for. missing : what to say where there is none.

    Raises FileError where it is missing, no regular file or cannot be opened
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise FileError(path, missing) from None
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        raise FileError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    mode = os.fstat(handle).st_mode
    if not stat.S_ISREG(mode):
        os.close(handle)
        raise FileError(path, next((text for kind, text in KINDS if kind(mode)), "is no regular file"))
    return os.fdopen(handle, "rb")


def read_bytes(path: Path, most: int = LARGEST, missing: str = "no such file") -> bytes:
    """All of a file, here or behind a URL. most : bytes. Raises FileError as `open_file` does, for a file larger than
    `most` and for one that cannot be read."""
    if remote_folders.is_remote(path):
        return _fetched(path, most, missing)
    with open_file(path, missing) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise FileError(path, f"has {size} bytes, more than the {most} that such a file may have")
        try:
            return file.read(most)
        except OSError as error:
            raise FileError(path, f"cannot be read: {error.strerror}") from None


def _fetched(path: Path, most: int, missing: str) -> bytes:
    """`read_bytes` of a file behind a URL."""
    try:
        data = remote_folders.read(path, most + 1)
    except FileNotFoundError:
        raise FileError(path, missing) from None
    if len(data) > most:
        raise FileError(path, f"has more than the {most} bytes that such a file may have")
    return data


def read_text(path: Path, most: int = LARGEST, missing: str = "no such file") -> str:
    """The text of a UTF-8 file, a byte order mark left out. Raises FileError as `read_bytes` does, and for what is no
    text.
    """
    data = read_bytes(path, most, missing)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise FileError(path, f"is no UTF-8 text: byte {data[error.start]:#04x}", line) from None
    if "\0" in text:
        raise FileError(path, "is no text: it holds a NUL byte", text[: text.index("\0")].count("\n") + 1)
    return text


def value_text(value: Any) -> str:
    """A value as a message repeats it: like repr, but never long."""
    try:
        text = repr(value if not isinstance(value, str) else value[: 2 * SHOWN])
    except (ValueError, RecursionError):
        return (
            "a number of thousands of digits"
            if isinstance(value, int)
            else f"a {type(value).__name__} too deep to show"
        )
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}.."
