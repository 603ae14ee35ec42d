"""User's own camera class, and image program.

A class in a file or package, and a program that is run for each image.
"""

import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from rig.array_and_json_types import Pixels
from rig.driving.cameras.camera_interface_and_synchronised_grabbing import UNIFORM, CameraError, Frame
from rig.driving.clock import Clock
from rig.driving.user_protocol_camera_and_sensor_classes import fail_at_class, guard_call, load_user_class
from rig.errors import FileError
from rig.model.design import Camera
from rig.recording.image_file_check_and_reading import decode_image

T = TypeVar("T")
GROUP = "rig.cameras"  # of entry points
WAIT = 30.0  # s that a program may take for an image
SHOWN = 300  # characters of what a program printed, in messages


class UserCamera:
    """Base class of a camera of the user's own. camera : its name, width and height as rig.toml states them."""

    can_set_exposure = False

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def grab(self) -> Pixels:
        """Image (height, width) or (height, width, 3) in uint8 or uint16, exposed after this call and before it
        returns. Raises CameraError where there is none.
        """
        raise NotImplementedError

    def set_exposure(self, seconds: float) -> float:
        """Expose for so long from now on; returns what the camera made of it, s. Raises CameraError where it cannot."""
        raise CameraError(f"camera {self.camera.name!r} does not set its exposure; state --exposure keep")

    def close(self) -> None:
        """Let go of the camera."""


class UserSource:
    """A Source (camera interface) made of a UserCamera, its images checked and timed."""

    def __init__(self, camera: Camera, clock: Clock) -> None:
        """Raises FileError or RigError where its program cannot be used."""
        kind, path = load_user_class(str(camera.source), UserCamera, GROUP, "camera")
        if kind.grab is UserCamera.grab:
            raise fail_at_class(path, kind, "lacks grab, which returns an image")
        self.name, self.can_set_exposure, self._camera, self._clock = camera.name, kind.can_set_exposure, camera, clock
        self._owner, self._path = kind, path
        self._user = self._guarded(kind)(camera)

    def _guarded(self, call: Callable[..., T]) -> Callable[..., T]:
        return guard_call(call, self._path, CameraError, self._owner.__name__)

    def grab(self) -> Frame:
        asked = self._clock.now()
        image = self._guarded(self._user.grab)()
        after = self._clock.now()
        return Frame(checked_image(image, self._camera), (asked + after) / 2, (after - asked) / UNIFORM)

    def set_exposure(self, seconds: float) -> float:
        return float(self._guarded(self._user.set_exposure)(seconds))

    def close(self) -> None:
        self._guarded(self._user.close)()


class CommandSource:
    """Images that a program writes to its standard output, as PNG, JPEG, TIFF, BMP or PGM. It is run for each grab, its
    words without a shell; `{name}`, `{width}` and `{height}` in them are the camera's.
    """

    can_set_exposure = False

    def __init__(self, camera: Camera, command: str, clock: Clock, wait: float = WAIT) -> None:
        """Raises CameraError for a command that cannot be parsed."""
        self.name, self._camera, self._clock, self._wait = camera.name, camera, clock, wait
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise CameraError(f"camera {camera.name!r}: command:{command} cannot be parsed: {error}") from None
        stated = {"{name}": camera.name, "{width}": str(camera.width), "{height}": str(camera.height)}
        for key, value in stated.items():
            words = [word.replace(key, value) for word in words]
        self._words = words

    def grab(self) -> Frame:
        asked = self._clock.now()
        try:
            done = subprocess.run(self._words, capture_output=True, timeout=self._wait, stdin=subprocess.DEVNULL)
        except OSError as error:
            raise CameraError(f"camera {self.name!r}: {self._words[0]} cannot be run: {error.strerror}") from None
        except subprocess.TimeoutExpired:
            raise CameraError(f"camera {self.name!r}: {self._words[0]} gave no image in {self._wait:g} s") from None
        after = self._clock.now()
        if done.returncode:
            said = done.stderr.decode("utf-8", "replace").strip()[-SHOWN:]
            raise CameraError(f"camera {self.name!r}: {self._words[0]} ended with {done.returncode}: {said}")
        try:
            image = decode_image(done.stdout, Path(f"output of {self._words[0]}"))
        except FileError as error:
            raise CameraError(f"camera {self.name!r}: {error}") from None
        return Frame(checked_image(image, self._camera), (asked + after) / 2, (after - asked) / UNIFORM)

    def set_exposure(self, seconds: float) -> float:
        """Raises CameraError: the program exposes."""
        raise CameraError(f"camera {self.name!r} is a command; its exposure is set by its program")

    def close(self) -> None:
        """Nothing is held open."""


def checked_image(image: object, camera: Camera) -> Pixels:
    """Checked image of a user's program.

    Raises CameraError for another size or type.
    """
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3):
        what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise CameraError(f"camera {camera.name!r} gives {what}, not an array of uint8 or uint16")
    expected = (camera.height, camera.width, 3)[: image.ndim]
    if image.shape != expected:
        raise CameraError(
            f"camera {camera.name!r} gives {image.shape[1]} x {image.shape[0]} px, but rig.toml has "
            f"{camera.width} x {camera.height} px"
        )
    return image
