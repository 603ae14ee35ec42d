"""GenICam camera (GigE Vision, USB3 Vision) through harvesters: software trigger, hardware timestamps."""

import os
from contextlib import AbstractContextManager
from typing import Protocol

import numpy as np

from rig.array_and_json_types import Integers
from rig.driving.cameras.camera_interface_and_grabbing import CameraError, ClockOffset, Frame
from rig.driving.clock import Clock
from rig.errors import MissingLibrary

WAIT = 5.0  # s for a frame after its trigger
STAMP = 1e-9  # s; GenICam counts nanoseconds unless the device says its tick frequency
LATCH = "TimestampLatch"


class Number(Protocol):
    """A setting of a camera. value, min, max : in the setting's own unit"""

    value: float
    min: float
    max: float


class Command(Protocol):
    """A command of a camera."""

    def execute(self) -> None:
        """Execute the command."""


class NodeMap(Protocol):
    """Settings and commands of a camera by their names, of which some cameras lack some."""

    TriggerSoftware: Command
    TimestampLatch: Command
    TimestampLatchValue: Number
    ExposureTime: Number


class Device(Protocol):
    """The camera at the other end."""

    node_map: NodeMap


class ImageComponent(Protocol):
    """An image of a buffer. data : (height width,); data_format : Mono8, .."""

    width: int
    height: int
    data_format: str
    data: Integers


class Payload(Protocol):
    """What a buffer holds."""

    components: list[ImageComponent]


class Buffer(AbstractContextManager["Buffer"], Protocol):
    """A buffer that goes back to its camera at the end. timestamp_ns : None or 0 where the camera stamps none"""

    payload: Payload
    timestamp_ns: int | None


class Acquirer(Protocol):
    """What is called of harvesters' ImageAcquirer, which has no types."""

    remote_device: Device

    def start(self) -> None:
        """Begin to acquire."""

    def fetch(self, *, timeout: float) -> Buffer | None:
        """The next buffer, None where none comes in timeout s."""

    def stop(self) -> None:
        """End acquiring."""

    def destroy(self) -> None:
        """Let go of the camera."""


class GenicamSource:
    """An acquiring camera. acquirer : harvesters' ImageAcquirer; size : (width, height) px"""

    can_set_exposure = True

    def __init__(self, name: str, acquirer: Acquirer, clock: Clock, size: tuple[int, int]) -> None:
        self.name, self._acquirer, self._clock, self._size, self._offset = name, acquirer, clock, size, ClockOffset()
        nodes = acquirer.remote_device.node_map
        self._nodes = nodes
        for node, value in (
            ("AcquisitionMode", "Continuous"),
            ("TriggerSelector", "FrameStart"),
            ("TriggerMode", "On"),
            ("TriggerSource", "Software"),
            ("ExposureMode", "Timed"),
            ("ExposureAuto", "Off"),
        ):
            if hasattr(nodes, node):
                getattr(nodes, node).value = value
        acquirer.start()

    def grab(self) -> Frame:
        """Trigger an exposure and wait for its image. Raises CameraError where none comes."""
        self._read_clock()
        before = self._clock.now()
        self._nodes.TriggerSoftware.execute()
        triggered = self._clock.now()
        try:
            buffer = self._acquirer.fetch(timeout=WAIT)
        except Exception as error:  # harvesters passes on whatever the producer raises
            raise CameraError(f"camera {self.name!r} gave no image in {WAIT:g} s after its trigger: {error}") from error
        if buffer is None:
            raise CameraError(f"camera {self.name!r} gave no image in {WAIT:g} s after its trigger")
        with buffer:
            image = self._image(buffer.payload.components[0])
            stamp = buffer.timestamp_ns * STAMP if buffer.timestamp_ns else None
        half = self._exposure() / 2
        if stamp is None:
            return Frame(image, (before + triggered) / 2 + half, max(triggered - before, 1e-3) / 2)
        self._offset.learn(before, stamp, self._clock.now())  # stamps are of the exposure's start, or later
        t, sigma = self._offset.host(stamp, self._clock.now())
        return Frame(image, t + half, sigma)

    def _read_clock(self) -> None:
        """Learn the offset from the camera's clock itself where it can be latched."""
        if not (hasattr(self._nodes, LATCH) and hasattr(self._nodes, "TimestampLatchValue")):
            return
        before = self._clock.now()
        self._nodes.TimestampLatch.execute()
        after = self._clock.now()
        self._offset.learn(before, self._nodes.TimestampLatchValue.value * STAMP, after)

    def _image(self, component: ImageComponent) -> Integers:
        """(height, width) uint8 or uint16 of a buffer's component, copied out of it."""
        if (component.width, component.height) != self._size:
            raise CameraError(
                f"camera {self.name!r} gives {component.width} x {component.height} px, but rig.toml has "
                f"{self._size[0]} x {self._size[1]} px"
            )
        form = component.data_format
        if not form.startswith("Mono") or form.endswith(("p", "Packed")):
            raise CameraError(
                f"camera {self.name!r} sends {form}; set its PixelFormat to Mono8, Mono10, Mono12 or Mono16"
            )
        image = np.array(component.data).reshape(component.height, component.width)
        bits = int(form[4:])
        return image.astype(np.uint8) if bits == 8 else image.astype(np.uint16) << (16 - bits)

    def _exposure(self) -> float:
        return float(self._nodes.ExposureTime.value) * 1e-6

    def set_exposure(self, seconds: float) -> float:
        """Expose for so long, within what the camera can."""
        node = self._nodes.ExposureTime
        node.value = min(max(seconds * 1e6, node.min), node.max)
        return self._exposure()

    def close(self) -> None:
        """Stop and let go of the camera."""
        self._acquirer.stop()
        self._acquirer.destroy()


def open_genicam_camera(name: str, serial: str, clock: Clock, size: tuple[int, int]) -> GenicamSource:
    """Open the GenICam camera with a serial number.
    Raises MissingLibrary without harvesters, CameraError where no such camera answers.

    GENICAM_GENTL64_PATH names the folders with the makers' producers (.cti files), as the GenTL standard has it.
    """
    try:
        from harvesters.core import Harvester
    except ImportError:
        raise MissingLibrary("GenICam cameras need the package harvesters; pip install 'rig[genicam]'") from None
    folders = [folder for folder in os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep) if folder]
    producers = [
        os.path.join(folder, file) for folder in folders for file in sorted(os.listdir(folder)) if file.endswith(".cti")
    ]
    if not producers:
        raise CameraError(
            f"camera {name!r}: no GenTL producer (.cti) in GENICAM_GENTL64_PATH = "
            f"{os.pathsep.join(folders)!r}; install the maker's"
        )
    harvester = Harvester()
    for producer in producers:
        harvester.add_file(producer)
    harvester.update()
    there = [info.serial_number for info in harvester.device_info_list]
    if serial not in there:
        harvester.reset()
        raise CameraError(
            f"camera {name!r}: no GenICam camera {serial!r}; there are {', '.join(map(repr, there)) or 'none'}"
        )
    return GenicamSource(name, harvester.create({"serial_number": serial}), clock, size)
