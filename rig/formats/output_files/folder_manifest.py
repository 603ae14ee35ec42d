"""Manifest of a folder: which command wrote which file, its digest, whether the folder is complete."""

import json
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from hashlib import sha256
from pathlib import Path

from rig.errors import FileError
from rig.formats import remote_folders
from rig.formats.input_files import require_schema

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
    (see rig.recording.recording_frames)"""

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
    """Load the FolderManifest of a folder, empty where there is none. Raises FileError for an invalid manifest.
    Raises FileError for a manifest that is none.
    """
    path = folder / MANIFEST
    try:
        tree = json.loads(
            (remote_folders.read(path) if remote_folders.is_remote(path) else path.read_bytes()).decode("utf-8")
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
                raise FileError(path, f"names {name!r}, which is no file of its folder")
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
            path,
            f"is no manifest of what was made in its folder ({type(error).__name__}: {error}); where it is "
            "nobody's, delete it",
        ) from None


def require_complete_folder(folder: Path) -> None:
    """Raise FileError unless a folder is complete, that is, no command was interrupted while writing it.
    A folder that nobody has marked is taken as it is.
    """
    origin = load_manifest(Path(folder)).origin
    if origin is not None and not origin.complete:
        raise FileError(folder, f"is not complete: `rig {origin.command}` was ended while it wrote it; run that again")


def file_digest(path: Path) -> str:
    """Digest (sha256, hexadecimal) of a file, "" for one that cannot be read."""
    whole = sha256()
    try:
        if remote_folders.is_remote(path):
            return sha256(remote_folders.read(path)).hexdigest()
        with open(path, "rb") as file:
            while block := file.read(1 << 20):
                whole.update(block)
    except OSError:
        return ""
    return whole.hexdigest()
