"""Folder camera: a watched folder into which another program writes images, read once they are complete."""

import os
from pathlib import Path
from typing import Any

from rig.arrays import Pixels
from rig.driving.cameras.camera_interface_and_clock import CameraError, Frame
from rig.driving.clock import Clock
from rig.errors import FileError
from rig.model.design import Camera
from rig.recording.exposures_and_images import read_image
from rig.recording.image_file_check import JPEG, PNG, image_file_problem, image_size_from_header

EVERY = 0.02  # s between looks
QUIET = 0.2  # s without growth after which a file without an end mark of its own counts as whole
WAIT = 30.0  # s for an image
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
        asked = self._clock.now()
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
                return Frame(image, (asked + first) / 2, max(first - asked, EVERY) / 12**0.5)
            if now - asked > self._wait:
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
            return read_image(path)
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
