"""A camera opened by the source that its rig.toml states."""

from pathlib import Path

from rig.driving.cameras.camera_interface import CameraError, Frame, Source
from rig.driving.cameras.emulated_camera import EmulatedSource
from rig.driving.cameras.folder_camera import FolderSource
from rig.driving.cameras.genicam_camera import open_genicam
from rig.driving.cameras.opencv_camera import open_video
from rig.driving.clock import Clock
from rig.model.design import Camera

KINDS = {
    "uvc": "uvc:0 or uvc:/dev/video0",
    "gstreamer": "gstreamer:PIPELINE ! appsink",
    "genicam": "genicam:SERIAL",
    "folder": "folder:/path",
    "emulator": "emulator:HOST:PORT",
}

__all__ = ["KINDS", "CameraError", "Frame", "Source", "open_source"]


def open_source(camera: Camera, clock: Clock) -> Source:
    """The camera that [[camera]] source names. Raises CameraError where it states none, and what opening it raises."""
    if camera.source is None:
        raise CameraError(f"camera {camera.name!r} has no source in rig.toml; it takes {', '.join(KINDS.values())}")
    kind, _, place = camera.source.partition(":")
    size = (camera.width, camera.height)
    if kind in ("uvc", "gstreamer"):
        return open_video(camera.name, kind, place, clock, size)
    if kind == "genicam":
        return open_genicam(camera.name, place, clock, size)
    if kind == "folder":
        return FolderSource(camera, Path(place), clock)
    return EmulatedSource(camera.name, place, clock, size)
