"""docs/tables.md out of the reader itself: the columns that it asks of every CSV file while it reads a recording that
has all of them.

`python -m docs.make.tables > docs/tables.md`
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.csv_and_parquet_tables_and_time_origin import PLAIN, Table, TableFormat
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder

HEAD = """# The tables of a recording, column by column

Made from what reads them (`python -m docs.make.tables`). Comma separated, a header line, decimal points, UTF-8. SI \
units and radians, whatever
units `rig.toml` states; temperatures are in degrees Celsius.
Columns may stand in any order; a column that is not known is set aside, unless it is one slip away from one that is \
known: then that is an error.
Times `t` are of one clock, in seconds from any origin (0, boot, 1970). [rig import](check.md) makes these files of \
nearly anything.
"""
FILES = {  # what each holds
    "commands.csv": "What was commanded: `t` and one column for each axis. Between two rows "
    "every axis moves linearly; equal "
    "rows are a dwell; after "
    "the last row it stays. Not there where nothing was commanded. An arm has `q1..qn` in place of `l1..l6`, "
    "two struts `l1,l2`, eight `l1..l8`.",
    "frames.csv": "One row for each exposure. Rows with the same `frame` were exposed together "
    "(within 1 ms). Always there.",
    "sensors.csv": "`t` and any channels; linear between rows. One row alone states what never "
    "changed; otherwise the log "
    "covers the exposures. "
    "May be left out.",
    "corners.csv": "Corners of markers as somebody found them in the images. With it the images "
    "themselves may be left out.",
    "poses.csv": "Poses of the platform in the base, of an outside instrument or of vision. May be left out. The same "
    "columns, with or without "
    "`t`, are those of the wanted poses that `rig correct --poses` reads. "
    'Of directions (`[instrument] kind = "direction"`) the columns are `frame,azimuth,elevation` or `frame,x,y,z`. '
    "Of a chain, `poses_stage1.csv` .. "
    "have those of the bodies "
    "that its stages below the last move, in the base.",
}
WORDS = {
    "t": "s, increasing; in frames.csv the middle of the exposure of the image's middle row",
    "l": "m, commanded length of each strut, joint centre to joint centre, controller zero included",
    "frame": "whole number from 0, in order; the same for all cameras exposed together",
    "camera": "name, as in rig.toml",
    "image": "path relative to the folder, as `images/cam0/0000.png`; empty where only corners are kept",
    "marker": "the marker's identity in its dictionary",
    "corner": "0..3 from the marker's own top left, clockwise",
    "u": "px, to the right; the centre of the first pixel is 0",
    "v": "px, downwards; the centre of the first pixel is 0",
    "sigma": "px, standard deviation of the corner along u as along v",
    "cuu": "px^2, variance along u",
    "cuv": "px^2, covariance of u and v",
    "cvv": "px^2, variance along v",
    "x": "m, platform in base",
    "y": "m",
    "z": "m",
    "rx": "rad, rotation vector, platform in base",
    "ry": "rad",
    "rz": "rad",
    "c": "m, rad: upper triangle of the covariance, order x y z rx ry rz, the small motion on the right, in the "
    "platform's frame; all 21 or none",
    "channel": "any value; the name says the unit",
}
RIG = {"cameras": 1, "cubes": 1}


def requested_columns() -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    """{file: (columns that must be there, columns that may be)} as the reader asks for them."""
    found: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {}
    read = csv_and_parquet_tables_and_time_origin.read_csv_table

    def noted(path: Any, required: tuple[str, ...], optional: tuple[str, ...] = (), form: TableFormat = PLAIN) -> Table:
        found[Path(path).name] = (required, optional)
        return read(path, required, optional, form)

    with TemporaryDirectory() as name, patch.object(csv_and_parquet_tables_and_time_origin, "read_csv_table", noted):
        recording_folder.load_recording(_sample(Path(name)))
    return {file: found[file] for file in FILES}


def _sample(folder: Path) -> Path:
    """A recording of one frame with every file that there can be."""
    (folder / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, **RIG))
    design = recording_folder.design_from_rig_toml.load_design(folder / "rig.toml")
    lengths = ",".join(f"{x:.4f}" for x in design.mechanism.strut_range.mean(axis=1))
    marker = design.targets[0].ids[0]
    for file, header, row in (
        ("commands.csv", "t,l1,l2,l3,l4,l5,l6", f"0,{lengths}"),
        ("frames.csv", "frame,t,camera,image", "0,1,cam0,"),
        ("sensors.csv", "t,ambient_temperature_C", "0,20"),
        ("poses.csv", "frame,x,y,z,rx,ry,rz", "0,0,0,0.4,0,0,0"),
        ("corners.csv", "frame,camera,marker,corner,u,v", f"0,cam0,{marker},0,10,10"),
    ):
        (folder / file).write_text(f"{header}\n{row}\n")
    return folder


def page() -> str:
    """The page in Markdown."""
    parts = [HEAD]
    for file, (required, optional) in requested_columns().items():
        rows = [
            f"| {name} | {heading} | {words} |"
            for heading, names in (("must be there", required), ("may be there", optional))
            for name, words in _folded(names)
        ]
        if file == "sensors.csv":
            rows += [f"| `{name}` | may be there | {words} |" for name, words in channels()]
        parts.append(f"\n## {file}\n\n{FILES[file]}\n\n| column | | what |\n|---|---|---|\n" + "\n".join(rows) + "\n")
    return "".join(parts)


def channels() -> list[tuple[str, str]]:
    """Names that a sensors.csv's channels have where the program knows what they are, with their units."""
    temperatures = (
        "ambient_temperature_C",
        "strut1_temperature_C` .. `strut6_temperature_C",
        "camera_NAME_temperature_C",
    )
    return [
        *((name, "degrees Celsius") for name in temperatures),
        ("payload_mass_kg", "kg"),
        ("gravity_x_m_s2`, `gravity_y_m_s2`, `gravity_z_m_s2", "m/s^2, gravity in the frame of a base that tilts"),
        ("m1` .. `mn", "m, measuring limbs"),
        ("anything else", "a covariate that the diagnosis may use by its name"),
    ]


def _folded(names: tuple[str, ...]) -> list[tuple[str, str]]:
    """(name, what it is), with numbered columns in one row."""
    rows: list[tuple[str, str]] = []
    for stem, first, last in (("l", "l1", "l6"), ("c", "c00", "c55")):
        if first in names:
            rows.append((f"`{first}` .. `{last}`", WORDS[stem]))
    plain = [(f"`{name}`", WORDS[name]) for name in names if name in WORDS]
    return plain + rows


if __name__ == "__main__":
    print(page(), end="")
