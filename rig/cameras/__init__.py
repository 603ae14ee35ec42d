"""Cameras of a rig: opened by what rig.toml says of them, grabbed together, told when they were exposed."""

from pathlib import Path

from rig.cameras.emulated import EmulatedSource
from rig.cameras.folder import FolderSource
from rig.cameras.genicam import open_genicam
from rig.cameras.source import CameraError, Frame, Source
from rig.cameras.video import open_video
from rig.clock import Clock
from rig.design import Camera

KINDS = {"uvc": "uvc:0 or uvc:/dev/video0", "gstreamer": "gstreamer:PIPELINE ! appsink", "genicam": "genicam:SERIAL",
         "folder": "folder:/path", "emulator": "emulator:HOST:PORT"}

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
