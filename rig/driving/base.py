"""Base classes that a user's own file imports, for a protocol with its emulator, a camera, or sensors."""

from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import CameraError, Frame, UserCamera
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import LineEmulator
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    Dialogue,
    LineProtocol,
    Segment,
    State,
    Verdict,
)
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import UserSensors

__all__ = [
    "CameraError",
    "Dialogue",
    "Frame",
    "LineEmulator",
    "LineProtocol",
    "Segment",
    "State",
    "UserCamera",
    "UserSensors",
    "Verdict",
]
