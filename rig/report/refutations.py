"""Refutations of result files, kept in refutations.json of their folder by SHA-256: read, look up, add.

A command that refutes a result, or finds what it leaves out, adds an entry to refutations.json in the result's folder.
It is read wherever the file is shown or used. A copy elsewhere carries no entry.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from rig.errors import FileError
from rig.formats.input_files import require_schema
from rig.formats.output_files import write_text
from rig.formats.output_files.folder_manifest import file_digest
from rig.report.verdict import State

NAME = "refutations.json"
SCHEMA = "refutations/1"
FIELDS = ("sha256", "file", "date", "command", "recording", "finding")


@dataclass(frozen=True, slots=True)
class Refutation:
    """sha256, file : of the result, its name; date : ISO 8601; command, recording : that found it, their names;
    finding : what it found, a sentence
    state : "bad" where the result is refuted, "check" where something acts that it leaves out"""

    sha256: str
    file: str
    date: str
    command: str
    recording: str
    finding: str
    state: State = State.BAD

    @property
    def line(self) -> str:
        """The entry as pages and commands show it."""
        verb = "refuted" if self.state == State.BAD else "doubted"
        return f"{verb} on {self.date} by {self.recording} (rig {self.command}): {self.finding}"


def load_refutations(folder: Path) -> tuple[Refutation, ...]:
    """Load the refutations of a folder, () where there are none. Raises FileError for an invalid file."""
    path = folder / NAME
    try:
        tree = json.loads(path.read_bytes().decode("utf-8"))
        require_schema(path, "list of refuted results", tree["schema"], (SCHEMA,))
        return tuple(
            Refutation(**{name: str(row[name]) for name in FIELDS}, state=State(row["state"]))
            for row in tree["refutations"]
        )
    except (FileNotFoundError, NotADirectoryError):
        return ()
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(path, f"is no list of refuted results ({type(error).__name__}: {error})") from None


def refutations_of_file(path: Path) -> tuple[Refutation, ...]:
    """Refutations of a result file, by its SHA-256, oldest first. Raises FileError as `load_refutations` does."""
    known = load_refutations(path.parent)
    own = file_digest(path) if known else ""
    return tuple(one for one in known if one.sha256 == own)


def add_refutation(place: Path, folder: Path, new: Refutation) -> None:
    """Add a refutation to those of a folder; it replaces one of the same file by the same command and recording.

    place : where the file waits to be put into the folder as NAME
    """
    kept = [
        one
        for one in load_refutations(folder)
        if (one.sha256, one.command, one.recording) != (new.sha256, new.command, new.recording)
    ]
    write_text(
        place, json.dumps({"schema": SCHEMA, "refutations": [asdict(one) for one in (*kept, new)]}, indent=1) + "\n"
    )
