"""Remote folders behind an fsspec URL (s3://, gs://, https://): tests, listing and reading by path.

`Path("s3://bucket/rec") / "frames.csv"` stands for s3://bucket/rec/frames.csv wherever outside data are read. Files
come one by one as they are read and are kept nowhere; `filecache::s3://bucket/rec` is fsspec's word for keeping them.
Nothing is ever written there.
"""

import os
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Protocol

from rig.errors import SCHEME, FileError, MissingLibrary

LISTED = 64  # folders whose entries are remembered


def is_remote(path: Path) -> bool:
    """Whether a path stands for a remote URL."""
    return _scheme(path) is not None


def remote_url(path: Path) -> str:
    """URL of a remote path. Raises ValueError where it stands for none."""
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
    """Absolute path of a local or remote path, links followed."""
    return path if is_remote(path) else path.resolve()


def exists(path: Path) -> bool:
    """Whether a file or a non-empty folder exists at a path. Raises FileError where that is unknown.
    Raises FileError where that cannot be asked.
    """
    return (
        path.exists()
        if not is_remote(path)
        else path.name in _entries(remote_url(path.parent)) or bool(_entries(remote_url(path)))
    )


def is_folder(path: Path) -> bool:
    """Whether a path is a folder. Raises FileError where that is unknown.
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
    """File size in bytes from its folder's listing, None where there is no such file.
    Raises FileError where that cannot be asked.
    """
    if is_remote(path):
        return _entries(remote_url(path.parent)).get(path.name)
    return path.stat().st_size if path.is_file() else None


def read(path: Path, max_bytes: int | None = None) -> bytes:
    """Read the bytes of a remote file, the first `max_bytes` at most.

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
        raise MissingLibrary(f"{address} takes one package more: {error}") from None
    except ValueError as error:
        from difflib import get_close_matches

        near = get_close_matches(address.split("://")[0], available_protocols(), 1)
        raise FileError(address, f"{error}" + (f"; did you mean {near[0]}://?" if near else "")) from None
    except Exception as error:
        raise _refused(address, error) from error


def _refused(address: str, error: Exception) -> FileError:
    return FileError(address, f"cannot be read: {str(error) or type(error).__name__}")
