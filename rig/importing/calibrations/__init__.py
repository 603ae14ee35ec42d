"""Cameras as other programs calibrated them: Kalibr, multical, caliscope, ROS and OpenCV, one module each, brought onto a rig.toml."""

from rig.importing.calibrations.onto import onto
from rig.importing.calibrations.read import KINDS, cameras

__all__ = ["KINDS", "cameras", "onto"]
