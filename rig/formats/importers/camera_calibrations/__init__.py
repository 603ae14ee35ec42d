"""Cameras as other programs calibrated them: Kalibr, multical, caliscope, ROS and OpenCV, one module each, brought onto a rig.toml."""

from rig.formats.importers.camera_calibrations.rig_toml_cameras import onto
from rig.formats.importers.camera_calibrations.calibration_reader import KINDS, cameras

__all__ = ["KINDS", "cameras", "onto"]
