"""What later recordings found against a calibration: shown wherever one is used, and written beside it by the commands
that find it.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.output_files.folder_manifest import file_digest
from rig.report.verdict import State

if TYPE_CHECKING:
    from rig.report.refutations import Refutation


def read_refutations(path: Path) -> tuple[Refutation, ...]:
    """The refutations of a calibration's file, each of which is named on the error output. Raises FileError for a list
    of them that is none.
    """
    from rig.report.refutations import refutations_of_file

    found = refutations_of_file(path)
    for one in found:
        print(f"warning: {path} was {one.line}", file=sys.stderr)
    return found


def write_refutation(arguments: Namespace, path: Path, recording: str, finding: str, state: State = State.BAD) -> None:
    """Write beside a calibration's file what a recording of a name found against it; where that cannot be written it is
    stated on the error output.

    finding : a sentence without its full stop; state : BAD where it is refuted, CHECK where it leaves something out
    """
    from rig.report.refutations import NAME, Refutation, add_refutation

    new = Refutation(
        file_digest(path), path.name, datetime.now(UTC).date().isoformat(), arguments.command, recording, finding, state
    )
    try:
        add_refutation(arguments.outputs.file(path.parent / NAME, own=True), path.parent, new)
    except RigError as error:
        print(f"warning: {path} was {new.line}; that could not be written beside it: {error}", file=sys.stderr)
        return
    print(
        f"{path} is marked as {'refuted' if state == State.BAD else 'doubted'} in {path.parent / NAME}", file=sys.stderr
    )


def near_by(*places: Path) -> list[Path]:
    """The JSON files beside places, each once."""
    folders = {place.resolve().parent for place in places}
    return sorted(path for folder in folders if folder.is_dir() for path in folder.glob("*.json"))
