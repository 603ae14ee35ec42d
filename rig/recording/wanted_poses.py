"""Poses that a machine is to take, and their table."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.formats.csv_and_parquet_tables_and_time_origin import PLAIN, TableFormat, TimeOrigin, read_csv_table
from rig.model.arm_branches_and_hands import hand_names, seen_hand
from rig.model.design import Instrument
from rig.recording.frame_and_hand_columns import HAND, rows_of_hand
from rig.recording.recording_table_loading_and_writing import Poses, load_instrument_poses, load_poses

POINTING = Instrument("rig", "rig", np.inf, None, "direction")  # as which wanted directions are read


@dataclass(frozen=True, slots=True, eq=False)
class WantedPoses:
    """Poses that a machine is to take. poses : Poses; t : (n,) s from the first, when each is to be held, or None where
    nobody says
    origin : of the owner's clock, by which times are told; directions : whether their z axes alone are wanted"""

    poses: Poses
    t: Floats | None = None
    origin: TimeOrigin = TimeOrigin()
    directions: bool = False


def load_wanted_poses(path: str | Path, form: TableFormat = PLAIN, mechanism: object = None) -> WantedPoses:
    """Load WantedPoses from a table frame,x,y,z,rx,ry,rz or frame,azimuth,elevation, with or without t.

    form : of the file; mechanism : that is to take them. Of an arm with several hands the rows of the hand at which it
    is seen are taken, where the table has a column hand. Raises FileError with line and column
    """
    rows, hands, hand = read_csv_table(path, ("frame",), form=form), hand_names(mechanism), seen_hand(mechanism)
    directions = "azimuth" in rows.columns
    if directions and hand is not None and HAND in rows.columns:
        rows.fail("a direction has no column hand; state whole poses", 0, HAND, rows.text(HAND)[0])
    poses = (
        load_instrument_poses(path, None, POINTING, form)
        if directions
        else load_poses(path, are_commands=True, form=form, hands=hands, hand=hand)
    )
    if "t" not in rows.columns:
        return WantedPoses(poses, None, TimeOrigin(), directions)
    rows = rows if hand is None else rows_of_hand(rows, hands, hand)
    origin = rows.first_time_origin()
    return WantedPoses(poses, rows.increasing_times(origin), origin, directions)
