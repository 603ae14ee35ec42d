"""Base classes for a file of the user's own: a protocol with its emulator, a camera, or sensors."""

from rig.driving.cameras.camera_interface_and_synchronised_grabbing import CameraError, Frame
from rig.driving.cameras.user_camera_class_and_image_program import UserCamera
from rig.driving.emulators.user_line_emulator_base import LineEmulator
from rig.driving.protocols.protocol_interface import Dialogue, Segment, State, Verdict
from rig.driving.protocols.user_line_protocol_base import LineProtocol
from rig.driving.sensor_reader import UserSensors

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
