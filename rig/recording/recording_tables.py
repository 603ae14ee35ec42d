"""Recording tables written as CSV: poses, corners, configurations, times."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from rig.arrays import Floats
from rig.formats import remote_folders
from rig.formats.input_files import read_bytes
from rig.formats.output_files import write_bytes, write_text
from rig.model.pose import TRIANGLE, angle_sigmas, pose_to_vector, roll_pitch_yaw
from rig.recording.corner_and_pose_tables import (
    CORNER_COLUMNS,
    CORNER_COVARIANCE,
    COVARIANCE_COLUMNS,
    POSE_COLUMNS,
    Corners,
    Poses,
)
from rig.recording.exposures_and_images import Exposures
from rig.recording.time_origin import Origin

ANGLES = ("x", "y", "z", "roll", "pitch", "yaw")


def write_table(path: Path, header: Iterable[str], rows: Iterable[str]) -> None:
    """Write a CSV table of a header (names) and rows (lines of text)."""
    write_text(path, "\n".join([",".join(header), *rows]) + "\n")


def write_configurations(path: Path, axis_names: Iterable[str], configurations: Iterable[Floats]) -> None:
    """Write a CSV of configurations (k, axes) m or rad, numbered from 0, for the plan commands:FILE."""
    write_table(
        path,
        ("frame", *axis_names),
        [f"{k}," + ",".join(f"{value:.7f}" for value in row) for k, row in enumerate(configurations)],
    )


def write_poses(path: Path, poses: Poses) -> None:
    """Write a poses.csv, with covariance where there is one; resolution 1e-10 m and rad."""
    header = ["frame", *POSE_COLUMNS, *(COVARIANCE_COLUMNS if poses.covariance is not None else ())]
    lines = [",".join(header)]
    for i, (frame, values) in enumerate(zip(poses.frame, pose_to_vector(poses.T_base_platform))):
        cells = [str(frame), *(f"{value:.10f}" for value in values)]
        if poses.covariance is not None:
            cells += [f"{value:.9e}" for value in poses.covariance[i][TRIANGLE]]
        lines.append(",".join(cells))
    write_text(path, "\n".join(lines) + "\n")


def write_poses_as_roll_pitch_yaw(path: Path, poses: Poses) -> None:
    """Write poses as x, y, z (m) and roll, pitch, yaw (rad), with standard deviations u_* where known."""
    sure = poses.covariance is not None
    rows = np.concatenate([poses.T_base_platform.translation, roll_pitch_yaw(poses.T_base_platform)], axis=-1)
    lines = [
        ",".join([str(frame), *(f"{value:.10f}" for value in row)])
        for frame, row in zip(poses.frame, np.atleast_2d(rows))
    ]
    if poses.covariance is not None:
        sigma = np.concatenate([_positions(poses), angle_sigmas(poses.T_base_platform, poses.covariance)], axis=-1)
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


def write_corners(path: Path, corners: Corners) -> None:
    """Write a corners.csv with sigma and the covariance of each corner."""
    c = corners
    header, form = [*CORNER_COLUMNS], "%d,%s,%d,%d,%.5f,%.5f"
    columns = [c.frame.tolist(), c.camera, c.marker.tolist(), c.corner.tolist(), *c.uv.T.tolist()]
    if c.covariance is not None:
        header, form = [*header, "sigma", *CORNER_COVARIANCE], form + ",%.5f,%.4e,%.4e,%.4e"
        (uu, uv), (_, vv) = np.moveaxis(c.covariance, 0, -1)
        columns += [column.tolist() for column in (np.sqrt((uu + vv) / 2), uu, uv, vv)]
    write_table(path, header, (form % row for row in zip(*columns)))


def copy_frames_commands_and_sensors(source: Path, target: Path, exposures: Exposures, origin: Origin) -> None:
    """Copy frames.csv (without image names), commands.csv and sensors.csv from one folder to another.

    origin : Origin that the folder's times are told by
    """
    lines = ["frame,t,camera,image"]
    lines += [
        f"{frame},{origin.text(t)},{camera},"
        for frame, t, camera in zip(exposures.frame, exposures.t, exposures.camera)
    ]
    write_text(Path(target) / "frames.csv", "\n".join(lines) + "\n")
    for name in ("commands.csv", "sensors.csv"):
        if remote_folders.exists(Path(source) / name):
            write_bytes(Path(target) / name, read_bytes(Path(source) / name))
