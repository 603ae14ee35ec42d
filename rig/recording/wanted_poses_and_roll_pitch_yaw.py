"""Wanted poses, and poses written as roll, pitch and yaw."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.formats.csv_and_parquet_tables_and_time_origin import PLAIN, TableFormat, TimeOrigin, read_csv_table
from rig.model.arm_hands_effect_places_and_tolerances import hand_names, selected_hand_name
from rig.model.design import Instrument
from rig.model.pose import roll_pitch_yaw, roll_pitch_yaw_sigmas
from rig.recording.corner_and_pose_csv_tables import (
    HAND,
    Poses,
    load_instrument_poses,
    load_poses,
    rows_of_hand,
    write_table,
)

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
    """Load WantedPoses from a table.

    It is frame,x,y,z,rx,ry,rz or frame,azimuth,elevation, with or without t.
    form : of the file; mechanism : that is to take them. Of an arm with several hands the rows of the hand at which it
    is seen are taken, where the table has a column hand. Raises FileError with line and column
    """
    rows = read_csv_table(path, ("frame",), form=form)
    hands, hand = hand_names(mechanism), selected_hand_name(mechanism)
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


ANGLES = ("x", "y", "z", "roll", "pitch", "yaw")


def write_poses_as_roll_pitch_yaw(path: Path, poses: Poses) -> None:
    """Write poses as roll, pitch and yaw (rad), with x, y, z (m).

    With standard deviations u_* where known.
    """
    sure = poses.covariance is not None
    rows = np.concatenate([poses.T_base_platform.translation, roll_pitch_yaw(poses.T_base_platform)], axis=-1)
    lines = [
        ",".join([str(frame), *(f"{value:.10f}" for value in row)])
        for frame, row in zip(poses.frame, np.atleast_2d(rows))
    ]
    if poses.covariance is not None:
        sigma = np.concatenate(
            [_positions(poses), roll_pitch_yaw_sigmas(poses.T_base_platform, poses.covariance)], axis=-1
        )
        lines = [
            line + "".join(f",{value:.4e}" if np.isfinite(value) else "," for value in row)
            for line, row in zip(lines, sigma)
        ]
    write_table(path, ("frame", *ANGLES, *(f"u_{name}" for name in ANGLES if sure)), lines)


def _positions(poses: Poses) -> Floats:
    """(n, 3) m, standard deviations along the static frame's axes: a covariance stands along the platform's."""
    R, C = poses.T_base_platform.rotation.as_matrix(), poses.covariance
    assert C is not None
    return np.sqrt(np.einsum("nij,njk,nik->ni", R, C[:, :3, :3], R))
