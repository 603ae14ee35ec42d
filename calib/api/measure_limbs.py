"""A recording's poses by accepted measuring limbs, in place of vision."""

from dataclasses import dataclass
from pathlib import Path

from calib.checks.recording_preparation import prepare_recording
from calib.online.limb_pose_source import LimbSource, checked_limb_poses
from calib.online.measuring_limb_poses import LimbPoses
from calib.online.measuring_limbs_file import Accepted
from rig.formats.input_files import read_bytes
from rig.formats.output_files import write_bytes
from rig.model.pose import rms_uncertainty
from rig.recording import recording_tables
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Poses
from rig.report.pages.html_elements import result_html
from vision.api import Progress
from vision.checks.recording_refusal import Notice, ignore_notice


@dataclass(frozen=True, slots=True, eq=False)
class LimbMeasurement:
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


def measure_limbs(
    recording: Recording,
    limbs: LimbSource,
    anyway: bool = False,
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
) -> LimbMeasurement:
    """LimbMeasurement of a recording, as `rig measure --limbs` makes it. anyway, notice : as of `calib.calibrate`

    Raises RigError for limbs that were not accepted, or with which vision no longer agrees
    """
    prepare_recording(recording, anyway, notice)
    return LimbMeasurement(recording, *checked_limb_poses(recording, limbs, progress, notice))
