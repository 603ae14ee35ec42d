"""Local and remote input files.

Opened and read: in folders, or behind a URL (s3, http) by fsspec.

`Path("s3://bucket/rec") / "frames.csv"` stands for s3://bucket/rec/frames.csv wherever outside data are read. Files
come one by one as they are read and are kept nowhere; `filecache::s3://bucket/rec` is fsspec's word for keeping them.
Nothing is ever written there.
"""

import os
import re
import stat
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, Protocol

from rig.errors import SCHEME, FileError, MissingLibrary

LISTED = 64  # folders whose entries are remembered


def is_remote(path: Path) -> bool:
    """Whether a path denotes a remote URL."""
    return _scheme(path) is not None


def remote_url(path: Path) -> str:
    """URL of a remote path.

    Raises ValueError where it stands for none.
    """
    at = _scheme(path)
    if at is None:
        raise ValueError(f"{path} stands for no URL")
    return f"{path.parts[at]}//{'/'.join(path.parts[at + 1 :])}"


def _scheme(path: Path) -> int | None:
    """Which of a path's parts is the scheme from which on it is a URL, None where none is."""
    parts = Path(path).parts
    found = [k for k, part in enumerate(parts) if part.endswith(":") and re.fullmatch(SCHEME, part)]
    return found[-1] if found and not os.path.exists(Path(*parts[: found[-1] + 1])) else None


def absolute_path(path: Path) -> Path:
    """Absolute path of a local or remote path.

    Links are followed.
    """
    return path if is_remote(path) else path.resolve()


def exists(path: Path) -> bool:
    """Whether a file or folder exists at a path.

    Behind a URL a folder that is not empty.
    Raises FileError where that cannot be asked.
    """
    return (
        path.exists()
        if not is_remote(path)
        else path.name in _entries(remote_url(path.parent)) or bool(_entries(remote_url(path)))
    )


def is_folder(path: Path) -> bool:
    """Whether a path is a folder.

    Raises FileError where that cannot be asked.
    """
    return path.is_dir() if not is_remote(path) else bool(_entries(remote_url(path)))


def is_empty(folder: Path) -> bool:
    """Whether a folder is empty."""
    return not list_folder(folder)


def list_folder(folder: Path) -> list[str]:
    """List of a folder's entries, sorted."""
    return sorted(_entries(remote_url(folder)) if is_remote(folder) else os.listdir(folder))


def file_size(path: Path) -> int | None:
    """File size in bytes, None where there is no such file.

    From its folder's listing behind a URL.
    Raises FileError where that cannot be asked.
    """
    if is_remote(path):
        return _entries(remote_url(path.parent)).get(path.name)
    return path.stat().st_size if path.is_file() else None


def read_remote_bytes(path: Path, max_bytes: int | None = None) -> bytes:
    """Read the bytes of a remote file.

    The first `max_bytes` at most.
    Raises FileNotFoundError where it is missing, MissingLibrary without what opens it, FileError for what else goes
        wrong
    """
    system, place = _system(remote_url(path))
    try:
        return system.cat_file(place, end=max_bytes)
    except (FileNotFoundError, IsADirectoryError):
        raise FileNotFoundError(remote_url(path)) from None
    except Exception as error:  # every kind of place has kinds of its own
        raise _refused(remote_url(path), error) from error


def clear_listing_cache() -> None:
    """Clear the cache of folder listings."""
    _entries.cache_clear()


@lru_cache(LISTED)
def _entries(folder: str) -> dict[str, int]:
    """{name: bytes} of what is in a folder behind a URL; nothing where there is none."""
    system, place = _system(folder)
    try:
        found = system.ls(place, detail=True)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except Exception as error:
        raise _refused(folder, error) from error
    sizes = {str(one["name"]).strip("/"): int(one.get("size") or 0) for one in found}
    return {name.rsplit("/", 1)[-1]: bytes_ for name, bytes_ in sizes.items() if name != place.strip("/")}


class FileSystem(Protocol):
    """What is called of fsspec's file systems, which have no types."""

    def cat_file(self, place: str, *, end: int | None) -> bytes:
        """A file's first bytes, `end` at most."""

    def ls(self, place: str, *, detail: bool) -> Sequence[Mapping[str, str | int | None]]:
        """A folder's entries, each with its name and size."""


def _system(address: str) -> tuple[FileSystem, str]:
    """(fsspec's file system, the place in it) of a URL."""
    try:
        from fsspec import available_protocols
        from fsspec.core import url_to_fs
    except ImportError:
        raise MissingLibrary(f"{address} is read by fsspec: pip install 'rig[remote]'") from None
    try:
        return url_to_fs(address)
    except ImportError as error:
        raise MissingLibrary(f"{address} requires one more package: {error}") from None
    except ValueError as error:
        near = get_close_matches(address.split("://")[0], available_protocols(), 1)
        raise FileError(address, f"{error}" + (f"; did you mean {near[0]}://?" if near else "")) from None
    except Exception as error:
        raise _refused(address, error) from error


def _refused(address: str, error: Exception) -> FileError:
    return FileError(address, f"cannot be read: {str(error) or type(error).__name__}")


BINARY: int = getattr(os, "O_BINARY", 0)  # of os.open on Windows, which else translates ends of lines
LARGEST = 1 << 28  # bytes of a text file
SHOWN = 80  # characters of a value that a message repeats
KINDS = (
    (stat.S_ISDIR, "is a folder, not a file"),
    (stat.S_ISFIFO, "is a pipe, not a file"),
    (stat.S_ISCHR, "is a device, not a file"),
    (stat.S_ISBLK, "is a device, not a file"),
    (stat.S_ISSOCK, "is a socket, not a file"),
)


def nearest_name_hint(path: Path) -> str:
    """Hint at the name nearest to that of a missing path, "" where none is near.

    Names are those in the path's folder.
    """
    try:
        near = get_close_matches(path.name, set(os.listdir(path.parent)) - {path.name}, 1)
    except OSError:  # the folder is missing as well, or cannot be listed
        return ""
    return f"; is {path.parent / near[0]} meant?" if near else ""


def open_regular_file(path: Path, missing_message: str = "no such file") -> BinaryIO:
    """Open a regular file for reading.

    Never waits for a pipe or device.
    missing_message : what to say where there is none.

    Raises FileError where it is missing, no regular file or cannot be opened
    """
    try:
        handle = os.open(path, os.O_RDONLY | BINARY | getattr(os, "O_NONBLOCK", 0))
    except FileNotFoundError:
        raise FileError(path, missing_message + nearest_name_hint(path)) from None
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        reason = KINDS[0][1] if isinstance(error, PermissionError) and path.is_dir() else None  # Windows opens none
        raise FileError(path, reason or f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    mode = os.fstat(handle).st_mode
    if not stat.S_ISREG(mode):
        os.close(handle)
        raise FileError(path, next((text for kind, text in KINDS if kind(mode)), "is not a regular file"))
    return os.fdopen(handle, "rb")


def read_bytes(path: Path, max_bytes: int = LARGEST, missing_message: str = "no such file") -> bytes:
    """Read the bytes of a file.

    Local or behind a URL. max_bytes : that it may have. Raises FileError as `open_regular_file` does, for a file
    larger than `max_bytes` and for one that cannot be read.
    """
    if is_remote(path):
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
        data = read_remote_bytes(path, most + 1)
    except FileNotFoundError:
        raise FileError(path, missing) from None
    if len(data) > most:
        raise FileError(path, f"has more than the {most} bytes that such a file may have")
    return data


def read_text(path: Path, max_bytes: int = LARGEST, missing_message: str = "no such file") -> str:
    """Read the text of a file.

    It is UTF-8; a byte order mark is left out.
    Raises FileError as `read_bytes` does, and for what is no text.
    """
    data = read_bytes(path, max_bytes, missing_message)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise FileError(path, f"is not UTF-8 text: byte {data[error.start]:#04x}", line) from None
    if "\0" in text:
        raise FileError(path, "is not text: it contains a NUL byte", text[: text.index("\0")].count("\n") + 1)
    return text


def short_repr(value: object) -> str:
    """Short repr of a value, truncated where long.

    For a message.
    """
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


def json_files_in_same_folders_as(paths: Iterable[Path]) -> list[Path]:
    """JSON files in the same folders as these paths, each once."""
    folders = {path.resolve().parent for path in paths}
    return sorted(path for folder in folders if folder.is_dir() for path in folder.glob("*.json"))
