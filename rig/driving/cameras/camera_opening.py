"""Opening of a camera by the source stated in rig.toml: uvc, gstreamer, genicam, folder or emulator."""

from pathlib import Path

from rig.driving.cameras.camera_interface_and_clock import CameraError, Frame, Source
from rig.driving.cameras.emulated_camera_client import EmulatedSource
from rig.driving.cameras.folder_camera import FolderSource
from rig.driving.cameras.genicam_camera import open_genicam_camera
from rig.driving.cameras.opencv_camera import open_opencv_camera
from rig.driving.clock import Clock
from rig.model.design import Camera

KINDS = {
    "uvc": "uvc:0 or uvc:/dev/video0",
    "gstreamer": "gstreamer:PIPELINE ! appsink",
    "genicam": "genicam:SERIAL",
    "folder": "folder:/path",
    "emulator": "emulator:HOST:PORT",
}

__all__ = ["KINDS", "CameraError", "Frame", "Source", "open_camera"]


def open_camera(camera: Camera, clock: Clock) -> Source:
    """Open the camera whose source is stated in its [[camera]] table.
    Raises CameraError where it states none, and what opening it raises.
    """
    if camera.source is None:
        raise CameraError(f"camera {camera.name!r} has no source in rig.toml; it takes {', '.join(KINDS.values())}")
    kind, _, place = camera.source.partition(":")
    size = (camera.width, camera.height)
    if kind in ("uvc", "gstreamer"):
        return open_opencv_camera(camera.name, kind, place, clock, size)
    if kind == "genicam":
        return open_genicam_camera(camera.name, place, clock, size)
    if kind == "folder":
        return FolderSource(camera, Path(place), clock)
    return EmulatedSource(camera.name, place, clock, size)
