"""Staged folder of outputs, and its manifest.

Files are written aside, then moved into the folder together with its manifest, which lists those of a command.
"""

import json
import os
import secrets
import shutil
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from hashlib import sha256
from pathlib import Path

from rig.errors import FileError, RigError
from rig.formats import local_and_remote_input_files
from rig.formats.local_and_remote_input_files import require_schema
from rig.formats.output_files.atomic_file_writing_and_process_locks import (
    HeldLock,
    lock_folder,
    path_status,
    sync_folder,
    write_text,
)

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
    """Whether a file name is that of a recording's table.

    Such as commands.csv, frames.csv.
    """
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
        return entry is not None and entry.command == command and file_sha256_or_empty(folder / name) in entry.sha256

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


def require_folder_of_uninterrupted_command(folder: Path) -> None:
    """Raise FileError where a command was interrupted while writing a folder.

    A folder that nobody has marked is taken as it is.
    """
    origin = load_manifest(Path(folder)).origin
    if origin is not None and not origin.complete:
        raise FileError(folder, f"is not complete: `rig {origin.command}` was ended while writing it; run that again")


def file_sha256_or_empty(path: Path) -> str:
    """SHA-256 digest of a file, "" for one that cannot be read.

    It is hexadecimal.
    """
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


NEW = ".rig-new-"
GROWING = f"{NEW}growing"  # stands in a folder, locked, while a command writes there in place


def lock_unused_folder(folder: Path) -> HeldLock:
    """Lock a folder in which no other process writes.

    Raises RigError where another process does, OSError where the folder cannot be opened.
    """
    try:
        return lock_folder(folder, wait=False)
    except BlockingIOError:
        raise RigError(
            f"another rig command is writing in {folder.parent if folder.name.startswith(NEW) else folder}"
        ) from None


class StagedFolder:
    """place : the folder, links resolved; folder : within it, where files wait; known : FolderManifest as it was when
    this began
    whole : whether the command makes all of the folder; allowed : names that may be written over without having been
        made by it"""

    def __init__(self, place: Path, command: str) -> None:
        """Make what is needed and find out whether it can be written. Raises OSError where it cannot."""
        self.place, self.command, self.whole, self.allowed = place, command, False, set[str]()
        self.fresh, self.marked = _missing(place), False
        try:
            place.mkdir(parents=True, exist_ok=True)
            self.known = load_manifest(place)
            lock = lock_folder(place, wait=True)
            try:
                remove_staged_files_of_killed_commands(place)
                self.folder = place / f"{NEW}{secrets.token_hex(6)}"
                self.folder.mkdir()
                self.lock = lock_folder(self.folder, wait=True)
            finally:
                lock.close()
        except BaseException:
            self._unmake()
            raise

    def mark(self, origin: FolderOrigin) -> None:
        """Say in a folder that holds nothing yet whose it is going to be. Raises RigError where a command writes there
        in place.
        """
        if (self.place / GROWING).exists():
            lock_unused_folder(self.place / GROWING).close()
        if self.known.origin is None and not any(entry != self.folder for entry in self.place.iterdir()):
            write_text(self.place / MANIFEST, FolderManifest(origin).text())
            self.marked = True

    def commit(self, origin: FolderOrigin, inputs: list[Path], force: bool) -> None:
        """Move what was staged to its place, and what the command left there before away. Raises RigError, and moves
        nothing, where that would write over what it did not make (unless forced) or over an input; FileError where the
        disk refuses."""
        lock = lock_folder(self.place, wait=True)
        try:
            known = load_manifest(self.place)
            new = sorted(path.relative_to(self.folder).as_posix() for path in _files(self.folder))
            if not new and not self.whole:
                return
            stale = self._stale(known, new)
            self._refuse(known, new, stale, inputs, force)
            entries = {name: ManifestEntry(self.command, (file_sha256_or_empty(self.folder / name),)) for name in new}
            retained = {
                name: entry
                for name, entry in known.files.items()
                if name not in stale and name not in entries and os.path.lexists(self.place / name)
            }
            old = {name: known.files[name] for name in known.files if name not in retained}
            both = {
                name: ManifestEntry(self.command, (*(old[name].sha256 if name in old else ()), *entry.sha256))
                for name, entry in entries.items()
            }
            whole = origin if self.whole else known.origin
            before = FolderManifest(
                replace(origin, complete=False) if self.whole else known.origin, retained | old | both
            )
            for name, made in (("before", before), ("after", FolderManifest(whole, retained | entries))):
                write_text(
                    self.folder / f"{NEW}{name}", made.text()
                )  # here, so that a full disk refuses it before anything is moved
            self._move(new, stale)
        except OSError as error:
            raise FileError(self.place, f"cannot be written: {error.strerror}") from None
        finally:
            lock.close()

    def discard(self) -> None:
        """Take away what is still staged, and folders that were made for nothing."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.lock.close()
        if self.marked and not any(entry.name != MANIFEST for entry in self.place.iterdir()):
            (self.place / MANIFEST).unlink()
        self._unmake()

    def _stale(self, known: FolderManifest, new: list[str]) -> list[str]:
        """Files in the way of the new ones: what the command left before, and what would be read together with them."""
        if not self.whole:
            return []
        stale = [name for name, entry in known.files.items() if entry.command == self.command and name not in new]
        for folder in {Path(name).parent for name in new} | {Path(".")}:
            place = self.place / folder
            for name in filter(
                is_recording_table, os.listdir(place) if "images" not in folder.parts and place.is_dir() else ()
            ):
                stale += [path.relative_to(self.place).as_posix() for path in _files(place / name)]
        return sorted({name for name in stale if name not in new and os.path.lexists(self.place / name)})

    def _refuse(self, known: FolderManifest, new: list[str], stale: list[str], inputs: list[Path], force: bool) -> None:
        given = [found for found in map(path_status, inputs) if found]
        inner = [real for real in (Path(os.path.realpath(path)) for path in inputs) if self.place in real.parents]
        for name in (*new, *stale):
            path = self.place / name
            if not Path(os.path.realpath(path.parent)).is_relative_to(self.place):
                raise FileError(path, "lies behind a link that leads out of the folder; name another place to write to")
            status = path_status(path)
            if status is None:
                continue
            if any(os.path.samestat(status, other) for other in given) or any(
                real in (path, *path.parents) for real in inner
            ):
                raise FileError(path, "is read by this command; it remains unchanged, name another place to write to")
            if not (force or name in self.allowed or known.untouched(self.place, name, self.command)):
                raise FileError(
                    path,
                    f"is there and was not left so by `rig {self.command}`; name another place, or write "
                    "over it with --force",
                )

    def _move(self, new: list[str], stale: list[str]) -> None:
        os.replace(self.folder / f"{NEW}before", self.place / MANIFEST)
        sync_folder(self.place)
        for name in stale:
            os.unlink(self.place / name)
        touched = {self.place}
        for name in new:
            target = self.place / name
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(self.folder / name, target)
            touched.add(target.parent)
        for name in stale:
            _prune((self.place / name).parent, self.place)
        for folder in touched:
            sync_folder(folder)
        os.replace(self.folder / f"{NEW}after", self.place / MANIFEST)
        sync_folder(self.place)

    def _unmake(self) -> None:
        for folder in self.fresh:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()


def remove_staged_files_of_killed_commands(folder: Path) -> None:
    """Remove stale staged files of killed commands from a folder."""
    for left in folder.glob(f"{NEW}*"):
        try:
            lock = lock_folder(left, wait=False)
        except OSError:
            continue  # whose it is lives, or it is no folder of ours
        shutil.rmtree(left, ignore_errors=True)
        lock.close()


def _missing(place: Path) -> list[Path]:
    """The folders on the way to a place that are not there, the deepest first."""
    return [folder for folder in (place, *place.parents) if not folder.exists()]


def _files(path: Path) -> list[Path]:
    return [inner for inner in path.rglob("*") if not inner.is_dir()] if path.is_dir() else [path]


def _prune(folder: Path, root: Path) -> None:
    """Remove a folder, and those above it within root, where nothing is left in them."""
    while folder != root and folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
