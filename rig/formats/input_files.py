"""Input files read as bytes or text: regular files of limited size; their schema checked; failures are FileErrors."""

import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

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


def open_regular_file(path: Path, missing_message: str = "no such file") -> BinaryIO:
    """Open a regular file for reading; never waits for a pipe or device.
    missing_message : what to say where there is none.

    Raises FileError where it is missing, no regular file or cannot be opened
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise FileError(path, missing_message) from None
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        raise FileError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    mode = os.fstat(handle).st_mode
    if not stat.S_ISREG(mode):
        os.close(handle)
        raise FileError(path, next((text for kind, text in KINDS if kind(mode)), "is no regular file"))
    return os.fdopen(handle, "rb")


def read_bytes(path: Path, max_bytes: int = LARGEST, missing_message: str = "no such file") -> bytes:
    """Read all bytes of a file, local or behind a URL, `max_bytes` at most.
    max_bytes : bytes. Raises FileError as `open_regular_file` does, for a file larger than `max_bytes` and for one that
        cannot be
    read. be read.
    """
    if remote_folders.is_remote(path):
        return _fetched(path, max_bytes, missing_message)
    with open_regular_file(path, missing_message) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise FileError(path, f"has {size} bytes, more than the {max_bytes} that such a file may have")
        try:
            return file.read(max_bytes)
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


def read_text(path: Path, max_bytes: int = LARGEST, missing_message: str = "no such file") -> str:
    """Read the text of a UTF-8 file, without its byte order mark.
    Raises FileError as `read_bytes` does, and for what is no text.
    """
    data = read_bytes(path, max_bytes, missing_message)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise FileError(path, f"is no UTF-8 text: byte {data[error.start]:#04x}", line) from None
    if "\0" in text:
        raise FileError(path, "is no text: it holds a NUL byte", text[: text.index("\0")].count("\n") + 1)
    return text


def short_repr(value: object) -> str:
    """Short repr of a value for a message, truncated where long."""
    try:
        text = repr(value if not isinstance(value, str) else value[: 2 * SHOWN])
    except (ValueError, RecursionError):
        return (
            "a number of thousands of digits"
            if isinstance(value, int)
            else f"a {type(value).__name__} too deep to show"
        )
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}.."


NAMED = re.compile(r"([a-z_]+)/([1-9][0-9]{0,8})")
LONGEST_NAMED = 80  # characters of what a file names that are shown


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
    shown, names = repr(found_schema)[:LONGEST_NAMED], " or ".join(f'"{schema}"' for schema in known_schemas)
    latest = {one[1]: int(one[2]) for schema in known_schemas if (one := NAMED.fullmatch(schema))}
    named = NAMED.fullmatch(found_schema) if isinstance(found_schema, str) else None
    if named and int(named[2]) > latest.get(named[1], int(named[2])):
        raise FileError(
            path,
            f"was written by a newer rig: its schema is {shown}, and this one reads {names}; install the newer one",
            *place,
        )
    raise FileError(path, f"is no {file_kind}: its schema is {shown}, not {names}", *place)


def json_files_in_same_folders(*places: Path) -> list[Path]:
    """JSON files in the same folders as the given paths, each once."""
    folders = {place.resolve().parent for place in places}
    return sorted(path for folder in folders if folder.is_dir() for path in folder.glob("*.json"))
