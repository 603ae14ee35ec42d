"""Atomic writing of files, and the manifest.

Files are written whole or not at all; the manifest lists the files that a command wrote into a folder.
"""

import errno
import json
import os
import re
import secrets
import stat
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from hashlib import sha256
from os import PathLike
from pathlib import Path

from rig.errors import FileError
from rig.formats import local_and_remote_input_files
from rig.formats.local_and_remote_input_files import BINARY, require_schema
from rig.formats.output_files.locks_of_files_and_folders import sync_open_folder

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
        there = path_status(path)
        own = _own_stream(there) if there is not None or Path(path) != STANDARD_OUTPUT else 1
        if there is not None and stat.S_ISDIR(there.st_mode):
            raise FileError(path, "is a folder, not a file to write")
        if own is not None:
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:  # a process may be started without
                    stream.flush()
            _all(own, data)
        elif there is not None and not stat.S_ISREG(there.st_mode):
            _straight(path, data)
        else:
            _replace(Path(os.path.realpath(path)), data, there)
    except BrokenPipeError:
        raise  # who read has gone away, which is no fault of the file
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None


def path_status(path: str | PathLike[str]) -> os.stat_result | None:
    """Status (stat) of what is at a path, links followed, or None for nothing.
    Raises OSError for what cannot be asked.
    """
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def is_written_directly(path: str | PathLike[str]) -> bool:
    """Whether a path is written directly, not atomically.

    A device, a pipe, or this process's standard output.
    """
    try:
        there = path_status(path)
    except OSError:
        return False
    return there is not None and (
        _own_stream(there) is not None or not (stat.S_ISREG(there.st_mode) or stat.S_ISDIR(there.st_mode))
    )


def _own_stream(there: os.stat_result | None) -> int | None:
    """1 or 2 where a file is what that descriptor goes to: renaming over it would leave the shell's redirection with a
    file nobody sees.
    """
    for descriptor in (1, 2):
        with suppress(OSError):  # a closed descriptor is nothing's
            if there is not None and os.path.samestat(there, os.fstat(descriptor)):
                return descriptor
    return None


def _straight(path: str | PathLike[str], data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | BINARY | getattr(os, "O_NOCTTY", 0))
    try:
        _all(descriptor, data)
    finally:
        os.close(descriptor)


def _replace(place: Path, data: bytes, there: os.stat_result | None) -> None:
    """Put data at a place that is no link. there : status of the regular file that it takes the place of, or None"""
    if there is not None and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    folder = _open_folder(place.parent)
    base = place.parent if folder is None else Path()
    part = base / PART.format(secrets.token_hex(8))
    try:
        mode = 0o666 if there is None else stat.S_IMODE(there.st_mode)
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_LINK | BINARY, mode, dir_fd=folder)
        try:
            try:
                if there is not None:
                    _alike(descriptor, there)
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


def _alike(descriptor: int, there: os.stat_result) -> None:
    """Give a new file the owner and the mode of the one whose place it takes; who is not root makes files of his own
    only.
    """
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        os.fchown(descriptor, there.st_uid, there.st_gid)
    if hasattr(os, "fchmod"):  # elsewhere (Windows) a mode says no more than whether a file may be written
        os.fchmod(descriptor, stat.S_IMODE(there.st_mode))


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


MANIFEST = ".rig-made.json"
SCHEMA = "made/1"
RECORDED = (
    "rig.toml",
    "commands.csv",
    "frames.csv",
    "sensors.csv",
    "corners.csv",
    "poses.csv",
    "poses_stage*.csv",
    "machine.json",
    "diagnosis.json",
    "images",
)  # what a folder is read from, so that what is left of one mixes with another


def is_recording_table(name: str) -> bool:
    """Whether a file name is that of a recording's table (commands.csv, frames.csv ..)."""
    return any(fnmatchcase(name, pattern) for pattern in RECORDED)


@dataclass(frozen=True, slots=True)
class FolderOrigin:
    """command : that makes a folder whole; arguments : as they were given, but for what a recording must not tell about
    its truth
    complete : whether it came to its end; data : marks of the exposures that what is in the folder was computed from
    (see rig.recording.frame_selection_and_content_hashes)"""

    command: str
    arguments: tuple[str, ...] = ()
    complete: bool = True
    data: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ManifestEntry:
    """command : that made a file; sha256 : of what it may hold as that command left it (two while one is being replaced
    by the other).
    """

    command: str
    sha256: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FolderManifest:
    """What is known of a folder. origin : of the folder as a whole, or None; files : {path in the folder, with /:
    Entry}.
    """

    origin: FolderOrigin | None = None
    files: dict[str, ManifestEntry] = field(default_factory=dict)

    def untouched(self, folder: Path, name: str, command: str) -> bool:
        """Whether a file is as a command left it."""
        entry = self.files.get(name)
        return entry is not None and entry.command == command and file_digest(folder / name) in entry.sha256

    def text(self) -> str:
        """The manifest's text, a line for each file."""
        origin = (
            "null"
            if self.origin is None
            else json.dumps(
                {
                    "command": self.origin.command,
                    "arguments": list(self.origin.arguments),
                    "complete": self.origin.complete,
                    "data": list(self.origin.data),
                }
            )
        )
        rows = [
            f"  {json.dumps(name)}: {json.dumps({'command': entry.command, 'sha256': list(entry.sha256)})}"
            for name, entry in sorted(self.files.items())
        ]
        return f'{{"schema": "{SCHEMA}",\n "origin": {origin},\n "files": {{\n' + ",\n".join(rows) + "\n}}\n"


def load_manifest(folder: Path) -> FolderManifest:
    """Load the FolderManifest of a folder, empty where there is none.

    Raises FileError for an invalid manifest.
    """
    path = folder / MANIFEST
    try:
        tree = json.loads(
            (
                local_and_remote_input_files.read_remote_bytes(path)
                if local_and_remote_input_files.is_remote(path)
                else path.read_bytes()
            ).decode("utf-8")
        )
        require_schema(path, "manifest of what was made in its folder", tree["schema"], (SCHEMA,))
        origin = tree["origin"] and FolderOrigin(
            str(tree["origin"]["command"]),
            tuple(map(str, tree["origin"]["arguments"])),
            tree["origin"]["complete"] is True,
            tuple(map(str, tree["origin"]["data"])),
        )
        for name in tree["files"]:
            if not name or name.startswith("/") or "\0" in name or {"", ".", ".."} & set(name.split("/")):
                raise FileError(path, f"names {name!r}, which is not a file of its folder")
        return FolderManifest(
            origin,
            {
                name: ManifestEntry(str(entry["command"]), tuple(map(str, entry["sha256"])))
                for name, entry in tree["files"].items()
            },
        )
    except (FileNotFoundError, NotADirectoryError):
        return FolderManifest()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileError(
            path, f"is not a manifest of its folder ({type(error).__name__}: {error}); where it is nobody's, delete it"
        ) from None


def require_complete_folder(folder: Path) -> None:
    """Raise FileError unless a folder is complete: no command was interrupted while writing it.

    A folder that nobody has marked is taken as it is.
    """
    origin = load_manifest(Path(folder)).origin
    if origin is not None and not origin.complete:
        raise FileError(folder, f"is not complete: `rig {origin.command}` was ended while writing it; run that again")


def file_digest(path: Path) -> str:
    """Digest (sha256, hexadecimal) of a file, "" for one that cannot be read."""
    whole = sha256()
    try:
        if local_and_remote_input_files.is_remote(path):
            return sha256(local_and_remote_input_files.read_remote_bytes(path)).hexdigest()
        with open(path, "rb") as file:
            while block := file.read(1 << 20):
                whole.update(block)
    except OSError:
        return ""
    return whole.hexdigest()
