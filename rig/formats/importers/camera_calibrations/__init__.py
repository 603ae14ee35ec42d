"""Cameras as other programs calibrated them: Kalibr, multical, caliscope, ROS and OpenCV, one module each, brought onto
a rig.toml.
"""

from rig.formats.importers.camera_calibrations.calibration_reader import KINDS, read_cameras
from rig.formats.importers.camera_calibrations.rig_toml_cameras import rig_toml_with_cameras

__all__ = ["KINDS", "read_cameras", "rig_toml_with_cameras"]
