"""Readings of a machine that measures to the poses that they stand for, corrected, with covariance."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.certification.calibration import Calibration
from calib.models.corrected_pose_covariance import corrected_pose_covariance
from rig.formats.csv_table import Table
from rig.model import mechanisms
from rig.recording.recording_tables import Poses, write_poses
from rig.report.pages.html_elements import result_html

BEYOND = 0.05  # of an axis' range, by which a reading may lie beyond it


@dataclass(frozen=True, slots=True, eq=False)
class ReadPoses:
    """Poses that a measuring machine's readings stand for. poses : Poses, corrected, with covariance; moved : m, RMS
    from what the owner's model reads; physics : whether the calibration knows physics, which is not taken off readings
    """

    poses: Poses
    moved: float
    physics: bool

    def __str__(self) -> str:
        assert self.poses.covariance is not None
        position, rotation = (
            float(np.sqrt(np.trace(self.poses.covariance[:, part, part], axis1=1, axis2=2).mean()))
            for part in (slice(0, 3), slice(3, 6))
        )
        return (
            f"{self.moved * 1e3:.4f} mm RMS from what the owner's model reads; "
            f"standard uncertainty {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad RMS"
        )

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(f"{len(self.poses.frame)} poses: {self}")

    def write(self, path: Path) -> None:
        """Write the poses as poses.csv."""
        write_poses(path, self.poses)


def poses_of_readings(calibration: Calibration, readings: Table) -> ReadPoses:
    """ReadPoses of a table frame,l1..l6 (an arm: q1..qn): the summands with the opposite sign.

    Raises FileError for a reading beyond its axis' range
    Source: configuration-space patent, [0062], [0068] to [0072], [0131]
    """
    correction, nominal = calibration.correction, calibration.correction.nominal
    kinematics = mechanisms.kinematics_of(nominal)
    values, frames = readings.matrix(nominal.axes), readings.whole("frame")
    far = np.abs(kinematics.limits(values, nominal)) > BEYOND * np.ptp(kinematics.travel(nominal), axis=1)
    if far.any():
        i, axis = np.argwhere(far)[0].tolist()
        readings.fail(f"{nominal.axes[axis]} is read beyond its range", i, nominal.axes[axis], values[i, axis])
    T = correction.predict(values)
    moved = np.linalg.norm(T.translation - kinematics.forward(values, nominal).translation, axis=1)
    return ReadPoses(
        Poses(frames, T, corrected_pose_covariance(calibration, T, values)),
        float(np.sqrt((moved**2).mean())),
        calibration.physics is not None,
    )
