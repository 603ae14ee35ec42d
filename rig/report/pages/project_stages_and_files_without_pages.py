"""Stages of a project, and its files without pages.

From its design to its diagnosis: which pages belong to each stage, and which files have no page.
Designs, recordings and corrected commands are files; all else is known by the page that its command writes.
"""

from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from rig.errors import FileError
from rig.formats.output_files import MANIFEST
from rig.formats.output_files.staged_folder_and_manifest import load_manifest

DESIGN, RECORDING, CORRECTION, OTHERS = "Design", "Recording", "Correction", "Other pages"
STAGES = {
    DESIGN: ("workspace",),
    RECORDING: ("plan", "view"),
    "Measurement": ("lens", "measure", "insitu"),
    "Calibration": ("calibrate", "online"),
    CORRECTION: (),
    "Verification": ("verify", "watch"),
    "Certificate": ("certify",),
    "Diagnosis": ("diagnose", "investigate"),
    OTHERS: (),
}  # in the order in which a project comes to them: kinds of pages

RECORDED_BY = ("run", "import", "simulate", "")  # commands whose folders are recordings, and nobody's


class ProjectFile(NamedTuple):
    """A file or folder that has no page. stage : of STAGES; path; text : what it is; changed : s"""

    stage: str
    path: Path
    text: str
    changed: float


def stage_of_page_kind(kind: str) -> str:
    """Project stage to which a kind of page belongs."""
    return next((stage for stage, kinds in STAGES.items() if kind in kinds), OTHERS)


def local_date_and_time_text(changed: float) -> str:
    """Text of a file's local date and time.

    To the minute. changed : s since 1970
    """
    return f"{datetime.fromtimestamp(changed):%Y-%m-%d %H:%M}"


def list_project_files(folder: Path, depth: int) -> list[ProjectFile]:
    """List project files in a folder and below it.

    Designs, recordings and corrected commands.
    depth : folders down to which they are looked for. A folder with an invalid manifest, or one that is being replaced
    meanwhile, is left out: each command that reads it names what is wrong
    """
    known: list[ProjectFile] = []
    below = [path for down in range(1, depth) for path in sorted(folder.glob("*/" * down))]
    for place in [folder, *below]:
        with suppress(FileError, OSError):
            known += _files_of_folder(place)
    return known


def _files_of_folder(place: Path) -> list[ProjectFile]:
    """Of one folder. Raises FileError for an invalid manifest, OSError for a file that is gone."""
    known: list[ProjectFile] = []
    tables = [path for name in ("frames.csv", "poses.csv") if (path := place / name).is_file()]
    made = load_manifest(place) if (place / MANIFEST).is_file() else None
    design, origin = place / "rig.toml", made.origin.command if made is not None and made.origin is not None else ""
    if not tables and design.is_file():
        known.append(ProjectFile(DESIGN, design, "the machine as stated", design.stat().st_mtime))
    elif tables and origin in RECORDED_BY:
        text = f"made by `rig {origin}`" if origin else "tables of a recording"
        known.append(ProjectFile(RECORDING, place, text, tables[0].stat().st_mtime))
    for name, entry in () if made is None else made.files.items():
        if entry.command == "correct" and (place / name).is_file():
            text, changed = "commands made by `rig correct`", (place / name).stat().st_mtime
            known.append(ProjectFile(CORRECTION, place / name, text, changed))
    return known
