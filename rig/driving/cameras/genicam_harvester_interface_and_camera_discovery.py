"""GenICam camera discovery, and the interface of a harvester.

As far as it is used, with the one Harvester of a process.
"""

import os
import threading
from contextlib import AbstractContextManager, suppress
from typing import Protocol

from rig.array_and_json_types import Integers
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import CameraError, ClockOffset
from rig.errors import MissingLibrary


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
    """A buffer that goes back to its camera at the end. timestamp_ns : None or 0 where the camera stamps none;
    producers before GenTL 1.5 raise an error for it and have the other two: ticks, and how many make a second
    """

    payload: Payload
    timestamp_ns: int | None
    timestamp: int
    timestamp_frequency: int


class Acquirer(Protocol):
    """What is called of harvesters' ImageAcquirer, which has no types."""

    remote_device: Device

    def start(self) -> None:
        """Begin to acquire."""

    def fetch(self, *, timeout: float) -> Buffer | None:
        """The next buffer, None where none comes in timeout s."""

    def try_fetch(self, *, timeout: float) -> Buffer | None:
        """The next buffer, None where none comes in timeout s."""

    def stop(self) -> None:
        """End acquiring."""

    def destroy(self) -> None:
        """Let go of the camera."""


class Found(Protocol):
    """A camera that a producer found. serial_number : its own"""

    serial_number: str


class Discovery(Protocol):
    """What is called of harvesters' Harvester, which has no types. device_info_list : the cameras found"""

    device_info_list: list[Found]

    def add_file(self, path: str) -> None:
        """Take a producer."""

    def update(self) -> None:
        """Look for cameras."""

    def create(self, which: int) -> Acquirer:
        """Open a camera, by its place in the list."""

    def reset(self) -> None:
        """Let go of all producers."""


class SharedHarvester:
    """The process's one Harvester, as a maker's producer may be opened once in a process; there while a camera is."""

    def __init__(self) -> None:
        self._harvester: Discovery | None = None
        self._users, self._lock = 0, threading.Lock()
        self.ptp = ClockOffset()  # of the one clock of all cameras that keep time by PTP

    def open(self, name: str, serial: str) -> Acquirer:
        """The camera with a serial number. Raises MissingLibrary without harvesters, CameraError where it does not
        answer; name : of the camera, for messages
        """
        with self._lock:
            if self._harvester is None:
                self._harvester = _harvester_of_producers(name)
            try:
                serial_numbers = [info.serial_number for info in self._harvester.device_info_list]
                if serial not in serial_numbers:
                    known = ", ".join(map(repr, serial_numbers)) or "none"
                    raise CameraError(f"camera {name!r}: no GenICam camera {serial!r}; there are {known}")
                acquirer = _opened(self._harvester, name, serial)
            except BaseException:
                self._reset_unused()
                raise
            self._users += 1
            return acquirer

    def close(self) -> None:
        """A camera that was opened is let go of."""
        with self._lock:
            self._users -= 1
            self._reset_unused()

    def _reset_unused(self) -> None:
        if not self._users and self._harvester is not None:
            with suppress(Exception):  # genicam's own kinds, of a camera that is gone
                self._harvester.reset()
            self._harvester, self.ptp = None, ClockOffset()


HARVESTER = SharedHarvester()


def _opened(harvester: Discovery, name: str, serial: str) -> Acquirer:
    """The camera with a serial number, opened. Where two producers, or two interfaces of this computer, find the same
    one, the first that opens it has it. Raises CameraError where none does.
    """
    failed: Exception | None = None
    for place, info in enumerate(harvester.device_info_list):
        if info.serial_number == serial:
            try:
                return harvester.create(place)
            except Exception as error:  # genicam's own kinds, of which there are many
                failed = error
    assert failed is not None, "the serial number is listed"
    raise CameraError(
        f"camera {name!r}: GenICam camera {serial!r} is there and cannot be opened; does another program have it open, "
        f"and is its address in the network of this computer? {error_text(failed)}"
    ) from failed


def error_text(error: Exception) -> str:
    """Text of an error of GenICam.

    Its kind where it states nothing else.
    """
    return str(error) or type(error).__name__


def _harvester_of_producers(name: str) -> Discovery:
    """A Harvester with all producers that there are; GENICAM_GENTL64_PATH names their folders, as the GenTL standard
    has it. Raises MissingLibrary without harvesters, CameraError where there is no producer (.cti file).
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
    harvester: Discovery = Harvester()
    for producer in producers:
        harvester.add_file(producer)
    harvester.update()
    return harvester
