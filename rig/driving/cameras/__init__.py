"""Cameras of a rig: opened by what rig.toml says of them, grabbed together, with the time at which they were
exposed.
"""

from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import CameraError, Frame, Source
from rig.driving.cameras.camera_opening_with_folder_and_emulator_sources import KINDS, open_camera

__all__ = ["KINDS", "CameraError", "Frame", "Source", "open_camera"]
