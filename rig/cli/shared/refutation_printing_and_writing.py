"""Printing and writing of a calibration's refutations."""

from __future__ import annotations

import sys
from argparse import Namespace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.output_files.atomic_file_and_manifest import file_digest

if TYPE_CHECKING:
    from rig.report.verdict_and_display import Refutation, State


def read_and_print_refutations(path: Path) -> tuple[Refutation, ...]:
    """Read the refutations of a calibration file, and print each as a warning.

    Raises FileError for an invalid list.
    """
    from rig.report.verdict_and_display import refutations_of_file

    found = refutations_of_file(path)
    print_refutations(path, found)
    return found


def print_refutations(path: Path, refutations: tuple[Refutation, ...]) -> None:
    """Print the refutations of a calibration's file.

    What later recordings found against it, on the error output.
    """
    for one in refutations:
        print(f"warning: {path} was {one.line}", file=sys.stderr)


def write_refutation(
    arguments: Namespace, path: Path, recording: str, finding: str, state: State | None = None
) -> None:
    """Write a refutation of a calibration by a recording's finding into its folder.

    Warns where that fails.

    finding : a sentence without its full stop; state : BAD (None), or CHECK where it leaves something out
    """
    from rig.report.verdict_and_display import NAME, Refutation, State, add_refutation

    state = State.BAD if state is None else state

    new = Refutation(
        file_digest(path), path.name, datetime.now(UTC).date().isoformat(), arguments.command, recording, finding, state
    )
    try:
        add_refutation(arguments.outputs.file(path.parent / NAME, own=True), path.parent, new)
    except RigError as error:
        print(f"warning: {path} was {new.line}; that could not be written next to it: {error}", file=sys.stderr)
        return
    print(
        f"{path} is marked as {'refuted' if state == State.BAD else 'doubted'} in {path.parent / NAME}", file=sys.stderr
    )
