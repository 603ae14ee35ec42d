"""Client of an emulated camera: requests images over TCP from the emulator that renders them.

A request is one line, `expose CAMERA SECONDS`. The answer is one line of JSON, {"width", "height", "bits", "age"} or
{"error"}, and the pixels, row by row (12 bits: two bytes each, low byte first). age (s): how long before the answer
began to be sent the exposure was.
"""

import json
import socket

import numpy as np

from rig.driving.cameras.camera_interface_and_clock import UNIFORM, CameraError, Frame
from rig.driving.clock import Clock

WAIT = 30.0  # s for an answer: pictures are drawn one after the other
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
        """A picture of the rig as it now stands. Raises CameraError where the emulator does not answer."""
        asked = self._clock.now()
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
        latest = max(after - tree["age"], asked)
        return Frame(image, (asked + latest) / 2, (latest - asked) / UNIFORM)

    def set_exposure(self, seconds: float) -> float:
        """Brighten or darken the pictures to come."""
        self._exposure = float(seconds)
        return self._exposure

    def close(self) -> None:
        """Hang up."""
        self._stream.close()
        self._socket.close()
