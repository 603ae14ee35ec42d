"""Opening of a camera, and its sources of a folder and of the emulator.

By its source in rig.toml.
Also the sources of a folder of images and of the emulator.

A request is one line, `expose CAMERA SECONDS`. The answer is one line of JSON, {"width", "height", "bits", "age"} or
{"error"}, and the pixels, row by row (12 bits: two bytes each, low byte first). age (s): how long before the answer
began to be sent the exposure was.
"""

import json
import os
import socket
from pathlib import Path
from typing import Any

import numpy as np

from rig.array_and_json_types import Pixels
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    UNIFORM,
    CameraError,
    CommandSource,
    Frame,
    Source,
    UserSource,
)
from rig.driving.cameras.genicam_camera import open_genicam_camera
from rig.driving.cameras.opencv_uvc_gstreamer_and_network_cameras import (
    open_gstreamer_camera,
    open_network_camera,
    open_uvc_camera,
)
from rig.driving.driving_clock import Clock
from rig.errors import FileError
from rig.model.design import Camera
from rig.model.protocol_port_and_user_program_name_checks import is_user_file_or_package
from rig.recording.exposures_and_image_files import (
    JPEG,
    PNG,
    image_file_problem,
    image_size_from_header,
    read_grey_or_colour_image,
)

EVERY = 0.02  # s between looks
QUIET = 0.2  # s without growth after which a file without an end mark of its own counts as whole
WAIT = 30.0  # s for an image; pictures of the emulator are drawn one after the other
TYPES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")


class FolderSource:
    """Images of a folder, each given once, oldest first. What was there at the start is left alone.

    Whoever writes them must expose after asking: `ask`, a file in the folder, is touched at every grab, for programs
    that wait for it.
    """

    can_set_exposure = False

    def __init__(self, camera: Camera, folder: Path, clock: Clock, wait: float = WAIT) -> None:
        self.name, self._camera, self._folder, self._clock, self._wait = camera.name, camera, Path(folder), clock, wait
        if not self._folder.is_dir():
            raise CameraError(f"camera {camera.name!r}: {folder} is no folder")
        self._known = set(self._names())

    def grab(self) -> Frame:
        """The next image that appears after this call and is whole; its time lies between the call and its appearance.

        Raises CameraError where none comes or one is of another size.
        """
        for name in self._names():  # dropped while nobody had asked: exposed some other time
            self._known.add(name)
        began = self._clock.now()
        sizes: dict[str, tuple[Any, ...]] = {}
        (self._folder / "ask").touch()
        while True:
            now = self._clock.now()
            for name in self._names():
                if name in self._known or not self._whole(self._folder / name, sizes, now):
                    continue
                self._known.add(name)
                image = self._decoded(self._folder / name)
                first = sizes[name][2]
                return Frame(image, (began + first) / 2, max(first - began, EVERY) / 12**0.5)
            if now - began > self._wait:
                raise CameraError(
                    f"camera {self.name!r}: no whole image appeared in {self._folder} within {self._wait:g} s"
                )
            self._clock.sleep(EVERY)

    def _decoded(self, path: Path) -> Pixels:
        """The image of a file, decoded once its size has been looked at. Raises CameraError for another size and for
        what is no image.
        """
        try:
            size, expected = image_size_from_header(path), (self._camera.width, self._camera.height)
            if size is not None and size != expected:
                raise CameraError(
                    f"camera {self.name!r}: {path} is {size[0]} x {size[1]} px, but rig.toml has "
                    f"{expected[0]} x {expected[1]} px"
                )
            return read_grey_or_colour_image(path)
        except FileError as error:
            raise CameraError(f"camera {self.name!r}: {error}") from None

    def _names(self) -> list[str]:
        return sorted(
            entry.name
            for entry in os.scandir(self._folder)
            if entry.name.lower().endswith(TYPES) and not entry.name.startswith(".")
        )

    def _whole(self, path: Path, sizes: dict[str, tuple[int, float, float]], now: float) -> bool:
        """Whether a file is whole; sizes : {name: (bytes, since when s, first seen s)}, kept up."""
        try:
            size = path.stat().st_size
            with open(path, "rb") as file:
                head = file.read(8)
        except OSError:  # taken away again
            return False
        before, since, first = sizes.get(path.name, (-1, now, now))
        sizes[path.name] = (size, since if size == before else now, first)
        if not size:
            return False
        if head.startswith((PNG, JPEG)):
            return "cut off" not in (image_file_problem(path, self._camera) or "")
        return size == before and now - since >= QUIET

    def set_exposure(self, seconds: float) -> float:
        """Raises CameraError: whoever drops the images exposes them."""
        raise CameraError(f"camera {self.name!r} is a watched folder; its exposure is set where its images are taken")

    def close(self) -> None:
        """Nothing is held open."""


USUAL = 0.01  # s; an exposure that makes a picture neither dark nor bright


class EmulatedSource:
    """One camera of the emulator that listens at an address."""

    can_set_exposure = True

    def __init__(self, name: str, address: str, clock: Clock, size: tuple[int, int]) -> None:
        """address : "host:port"; size : (width, height) px. Raises CameraError where nobody listens."""
        self.name, self._address, self._clock, self._size, self._exposure = name, address, clock, size, USUAL
        host, _, port = address.rpartition(":")
        if not host or not port.isdigit():
            raise CameraError(f'camera {name!r}: expected source = "emulator:HOST:PORT", got "emulator:{address}"')
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=WAIT)
        except OSError as error:
            raise CameraError(
                f"camera {name!r}: no emulator draws pictures at {address} ({error.strerror or error}); "
                "`rig emulate .. --cameras PORT` does"
            ) from None
        self._stream = self._socket.makefile("rb")

    def grab(self) -> Frame:
        """A picture of the rig in its present state. Raises CameraError where the emulator does not answer."""
        began = self._clock.now()
        try:
            self._socket.sendall(f"expose {self.name} {self._exposure!r}\n".encode())
            head = self._stream.readline(4096)
            after = self._clock.now()
            if not head.endswith(b"\n"):
                raise CameraError(f"camera {self.name!r}: the emulator at {self._address} is gone")
            tree = json.loads(head)
            if "error" in tree:
                raise CameraError(f"camera {self.name!r}: {tree['error']}")
            count = tree["width"] * tree["height"] * (1 if tree["bits"] == 8 else 2)
            data = self._stream.read(count)
        except (OSError, ValueError, KeyError) as error:
            raise CameraError(
                f"camera {self.name!r}: the emulator at {self._address} did not answer: {error}"
            ) from None
        if len(data) < count:
            raise CameraError(
                f"camera {self.name!r}: the emulator's picture was cut off after {len(data)} of {count} bytes"
            )
        if (tree["width"], tree["height"]) != self._size:
            raise CameraError(
                f"camera {self.name!r} gives {tree['width']} x {tree['height']} px, but rig.toml has "
                f"{self._size[0]} x {self._size[1]} px"
            )
        image = np.frombuffer(data, np.uint8 if tree["bits"] == 8 else "<u2").reshape(tree["height"], tree["width"])
        if tree["bits"] != 8:
            image = image.astype(np.uint16) << (16 - tree["bits"])  # as a 16-bit file holds it
        latest = max(after - tree["age"], began)
        return Frame(image, (began + latest) / 2, (latest - began) / UNIFORM)

    def set_exposure(self, seconds: float) -> float:
        """Brighten or darken the pictures to come."""
        self._exposure = float(seconds)
        return self._exposure

    def close(self) -> None:
        """Hang up."""
        self._stream.close()
        self._socket.close()


KINDS = {
    "uvc": "uvc:0 or uvc:/dev/video0",
    "gstreamer": "gstreamer:PIPELINE ! appsink",
    "genicam": "genicam:SERIAL",
    "folder": "folder:/path",
    "emulator": "emulator:HOST:PORT",
    "command": "command:PROGRAM WORDS",
    "http": "http://HOST/STREAM",
    "https": "https://HOST/STREAM",
    "rtsp": "rtsp://HOST/STREAM",
    "file": "file:NAME.py",
    "package": "package:NAME",
}


def open_camera(camera: Camera, clock: Clock) -> Source:
    """Open a camera.

    By the source that its [[camera]] table states.
    Raises CameraError where it states none, and what opening it raises.
    """
    if camera.source is None:
        raise CameraError(f"camera {camera.name!r} has no source in rig.toml; it takes {', '.join(KINDS.values())}")
    kind, _, place = camera.source.partition(":")
    size = (camera.width, camera.height)
    if kind == "uvc":
        return open_uvc_camera(camera.name, place, clock, size, camera.capture)
    if kind == "gstreamer":
        return open_gstreamer_camera(camera.name, place, clock, size)
    if kind in ("http", "https", "rtsp"):
        return open_network_camera(camera.name, camera.source, clock, size)
    if kind == "command":
        return CommandSource(camera, place, clock)
    if is_user_file_or_package(camera.source):
        return UserSource(camera, clock)
    if kind == "genicam":
        return open_genicam_camera(camera.name, place, clock, size, camera.capture)
    if kind == "folder":
        return FolderSource(camera, Path(place), clock)
    return EmulatedSource(camera.name, place, clock, size)
