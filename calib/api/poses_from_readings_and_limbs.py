"""Poses from a measuring machine's readings, corrected, or from a recording's accepted measuring limbs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.api.recording_check_and_preparation import refuse_unfit_recording
from calib.certification.calibration_and_claim_sentences import Calibration
from calib.models.machine_models import corrected_pose_covariance
from calib.online.measuring_limb_poses import LimbPoses, LimbSource, checked_limb_poses
from calib.online.measuring_limbs_file import Accepted
from rig.formats.csv_table import Table
from rig.formats.input_files import read_bytes
from rig.formats.output_files import write_bytes
from rig.model import mechanisms
from rig.model.pose import rms_uncertainty
from rig.recording import recording_tables
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Poses, write_poses
from rig.report.pages.html_and_svg_elements import result_html
from vision.api import Progress
from vision.checks.recording_refusal import Notice, ignore_notice


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLimbPoses:
    """Poses by measuring limbs. recording; poses : LimbPoses; accepted : the limbs they are from."""

    recording: Recording
    poses: LimbPoses
    accepted: Accepted

    def __str__(self) -> str:
        position, rotation = rms_uncertainty(self.poses.covariance)
        return f"{len(self.poses.frames)} poses by limbs, to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self))

    def write(self, folder: Path) -> None:
        """Write it as a recording into a folder, rig.toml as stated."""
        recording, found = self.recording, self.poses
        write_bytes(folder / "rig.toml", read_bytes(recording.folder / "rig.toml"))
        poses = Poses(found.frames, found.T_base_platform, found.covariance)
        recording_tables.write_poses(folder / "poses.csv", poses)
        recording_tables.write_poses_as_roll_pitch_yaw(folder / "rpy.csv", poses)
        recording_tables.copy_frames_commands_and_sensors(
            recording.folder, folder, recording.exposures, recording.origin
        )


def measure_poses_by_limbs(
    recording: Recording,
    limbs: LimbSource,
    anyway: bool = False,
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
) -> MeasuredLimbPoses:
    """Poses of a recording measured by its accepted measuring limbs, as `rig measure --limbs` makes them.

    Raises RigError for limbs that were not accepted, or with which vision no longer agrees
    """
    refuse_unfit_recording(recording, anyway, notice)
    return MeasuredLimbPoses(recording, *checked_limb_poses(recording, limbs, progress, notice))


BEYOND = 0.05  # of an axis' range, by which a reading may lie beyond it


@dataclass(frozen=True, slots=True, eq=False)
class PosesOfReadings:
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


def poses_of_readings(calibration: Calibration, readings: Table) -> PosesOfReadings:
    """Poses that a measuring machine's readings (table frame,l1..l6; an arm: q1..qn) stand for, corrected.

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
    return PosesOfReadings(
        Poses(frames, T, corrected_pose_covariance(calibration, T, values)),
        float(np.sqrt((moved**2).mean())),
        calibration.physics is not None,
    )
