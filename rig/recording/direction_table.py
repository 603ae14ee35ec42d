"""Table of directions, as of a telescope at stars.

Azimuth and elevation, or unit vectors.
"""

from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.formats.csv_and_parquet_tables_and_time_origin import PLAIN, Table, TableFormat, read_csv_table

ANGLES = ("azimuth", "elevation")  # columns, rad
VECTOR = ("x", "y", "z")
UNIT_LENGTH = 1e-6  # that a direction's length may differ from one


def read_direction_table(path: str | Path, form: TableFormat = PLAIN) -> tuple[Table, Floats]:
    """Table of directions read from a poses.csv.

    form : of the file
    Returns (Table, unit vectors (n, 3)) of columns azimuth and elevation (rad), or x, y and z
    Raises FileError with line and column for a missing column, angles that no circle has and vectors that are not of
    length one
    """
    angles = any(name in read_csv_table(path, ("frame",), form=form).columns for name in ANGLES)
    rows = read_csv_table(path, ("frame", *(ANGLES if angles else VECTOR)), form=form)
    if not angles:
        values = rows.matrix(VECTOR)
        length = np.linalg.norm(values, axis=1)
        bad = np.flatnonzero(np.abs(length - 1) > UNIT_LENGTH)
        if len(bad):
            rows.fail(f"a direction has length 1, not {length[bad[0]]:.9g}", bad[0], "x", values[bad[0], 0])
        return rows, values / length[:, None]
    values = form.units.si(rows.matrix(ANGLES), ("rad", "rad"))
    for k, most in enumerate((2 * np.pi, np.pi / 2)):
        bad = np.flatnonzero(np.abs(values[:, k]) > most)
        if len(bad):
            rows.fail(
                f"{ANGLES[k]} = {form.units.shown(values[bad[0], k], 'rad')} is implausible"
                + (" (degrees?)" if form.units.angle == "rad" else ""),
                bad[0],
                ANGLES[k],
                values[bad[0], k],
            )
    return rows, directions_of_angles(values)


def directions_of_angles(angles: Floats) -> Floats:
    """Unit vectors (..., 3) of azimuth and elevation (..., 2) rad, in a frame with x north, y east and z down."""
    azimuth, elevation = np.moveaxis(np.asarray(angles, float), -1, 0)
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)], axis=-1)
