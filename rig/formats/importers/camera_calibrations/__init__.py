"""Cameras as other programs calibrated them: Kalibr, multical, caliscope, ROS and OpenCV, brought onto
a rig.toml.
"""

from rig.formats.importers.camera_calibrations.calibration_files_to_rig_toml import (
    read_calibration_program_and_cameras,
    rig_toml_with_cameras,
)

__all__ = ["read_calibration_program_and_cameras", "rig_toml_with_cameras"]
