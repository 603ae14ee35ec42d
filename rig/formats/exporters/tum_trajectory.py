"""A recording's poses as a trajectory of TUM, its tables as Parquet: what evaluation tools and data frames read.

TUM: a line for each pose, `t x y z qx qy qz qw`, s and m, the quaternion's real part last, of the platform in the base
frame.
Source: TUM RGB-D benchmark, file formats
"""

from pathlib import Path

from rig.errors import RigError
from rig.formats import csv_table
from rig.formats.parquet_table import parquet_bytes
from rig.recording.recording_folder import Recording

TABLES = ("commands", "frames", "sensors", "corners", "poses")
WHOLE, TEXT = ("frame", "marker", "corner"), ("camera", "image")  # columns; all others are numbers


def tum_trajectory(recording: Recording) -> str:
    """TUM's text of a recording's poses, in order of time. Raises RigError where it has none."""
    poses = recording.poses
    if poses is None or not len(poses.frame):
        raise RigError(f"{recording.folder}: has no poses.csv; rig measure writes one")
    frames, times = recording.exposures.times()
    at = dict(zip(frames.tolist(), times.tolist()))
    lines = ["# t x y z qx qy qz qw"]
    rows = sorted(zip((at[int(frame)] for frame in poses.frame), poses.T_base_platform), key=lambda row: row[0])
    for t, T in rows:
        figures = (*T.translation.tolist(), *T.rotation.as_quat(canonical=True).tolist())
        lines.append(" ".join([recording.origin.text(t), *(f"{value:.12g}" for value in figures)]))
    return "\n".join(lines) + "\n"


def parquet_tables(folder: Path) -> dict[str, bytes]:
    """{name: Parquet file} of the tables in a recording's folder; frames, markers and corners whole numbers, names
    text, all else doubles.

    Raises MissingLibrary without pyarrow, FileError for a table that cannot be read
    """
    found = [name for name in TABLES if (folder / f"{name}.csv").is_file()]
    return {name: parquet_bytes(_columns(csv_table.read(folder / f"{name}.csv", ()))) for name in found}


def _columns(rows: csv_table.Table) -> dict[str, list]:
    return {
        name: rows.text(name) if name in TEXT else (rows.whole(name) if name in WHOLE else rows.numbers(name)).tolist()
        for name in rows.columns
    }
