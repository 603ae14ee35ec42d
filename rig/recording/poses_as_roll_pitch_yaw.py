"""Poses written as roll, pitch and yaw, with standard deviations."""

from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.model.pose import roll_pitch_yaw, roll_pitch_yaw_sigmas
from rig.recording.recording_table_loading_and_writing import Poses, write_table

ANGLES = ("x", "y", "z", "roll", "pitch", "yaw")


def write_poses_as_roll_pitch_yaw(path: Path, poses: Poses) -> None:
    """Write poses as x, y, z (m) and roll, pitch, yaw (rad), with standard deviations u_* where known."""
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
