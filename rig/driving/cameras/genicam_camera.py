"""GenICam camera through harvesters.

GigE Vision and USB3 Vision: triggered by the run, or by an edge that another camera's strobe gives; hardware
timestamps, of one clock where cameras keep time by PTP.
Source: GenICam Standard Features Naming Convention 2.7, chapters Acquisition Control, Digital I/O, PTP Control
"""

import os
import re
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, cast

import numpy as np

from rig.array_and_json_types import Integers
from rig.driving.cameras.camera_interface_and_user_cameras import CameraError, ClockOffset, Frame
from rig.driving.clock import Clock
from rig.errors import MissingLibrary
from rig.model.design import AS_IT_IS, CaptureSettings

WAIT = 5.0  # s for a frame after its trigger
STAMP = 1e-9  # s; GenICam counts nanoseconds unless the device says its tick frequency
LATCH = "TimestampLatch"
DRAIN = 1e-3  # s for an image that an earlier edge exposed
PTP_LOCKS, PTP_POLL = 30.0, 0.5  # s in which a camera follows PTP; s between looks
PTP_NODES = (
    ("PtpEnable", "PtpDataSetLatch", "PtpStatus"),
    ("GevIEEE1588", "GevIEEE1588DataSetLatch", "GevIEEE1588Status"),
)
FORMAT = re.compile(r"(Mono|Bayer(?:RG|GB|GR|BG)|RGB|BGR)(8|10|12|14|16)")
BAYER = {"RG": "RGGB", "GB": "GBRG", "GR": "GRBG", "BG": "BGGR"}  # first two of a row, and all four as OpenCV has it


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

    def create(self, which: dict[str, str]) -> Acquirer:
        """Open a camera."""

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
                acquirer = self._harvester.create({"serial_number": serial})
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
            self._harvester.reset()
            self._harvester, self.ptp = None, ClockOffset()


HARVESTER = SharedHarvester()


class GenicamSource:
    """An acquiring camera. acquirer : harvesters' ImageAcquirer; size : (width, height) px; settings : of the camera;
    let_go : called once it is closed; ptp : offset of the clock of PTP, for cameras that keep it. Raises CameraError
    for a setting that the camera does not take, and for one that does not follow PTP
    """

    def __init__(
        self,
        name: str,
        acquirer: Acquirer,
        clock: Clock,
        size: tuple[int, int],
        settings: CaptureSettings = AS_IT_IS,
        let_go: Callable[[], None] = lambda: None,
        ptp: ClockOffset | None = None,
    ) -> None:
        self._let_go, self._settings = let_go, settings
        self.waits_for_edge = bool(settings.trigger)
        self.can_set_exposure = not self.waits_for_edge  # which is found by images that nothing would trigger
        self._armed = clock.now()
        self._offset = ptp if ptp is not None and settings.ptp else ClockOffset()
        self.name, self._acquirer, self._clock, self._size = name, acquirer, clock, size
        nodes = acquirer.remote_device.node_map
        self._nodes = nodes
        for node, value in (
            ("AcquisitionMode", "Continuous"),
            ("TriggerSelector", "FrameStart"),
            ("TriggerMode", "On"),
            ("TriggerSource", "Software"),
            ("ExposureMode", "Timed"),
            ("ExposureAuto", "Off"),
            ("BalanceWhiteAuto", "Off"),  # or colours change from frame to frame
        ):
            if hasattr(nodes, node):
                getattr(nodes, node).value = value
        if settings.pixel_format:
            self._set("PixelFormat", settings.pixel_format)
        if settings.gain is not None:
            if hasattr(nodes, "GainAuto"):
                nodes.GainAuto.value = "Off"
            self._set("Gain", settings.gain)
        if settings.trigger:
            self._set("TriggerSource", settings.trigger)
        if settings.strobe:
            for node, value in (
                ("LineSelector", settings.strobe),
                ("LineMode", "Output"),
                ("LineSource", "ExposureActive"),
            ):
                self._set(node, value)
        if settings.ptp:
            self._follow_ptp()
        acquirer.start()

    def _follow_ptp(self) -> None:
        """Have the camera keep time by PTP. Raises CameraError where it cannot, or does not within PTP_LOCKS."""
        nodes = next((names for names in PTP_NODES if hasattr(self._nodes, names[0])), None)
        if nodes is None:
            raise CameraError(f"camera {self.name!r} does not keep time by PTP: it has no {PTP_NODES[0][0]}")
        self._set(nodes[0], True)
        end, status = self._clock.now() + PTP_LOCKS, ""
        while self._clock.now() < end:
            if hasattr(self._nodes, nodes[1]):
                getattr(self._nodes, nodes[1]).execute()
            status = str(getattr(self._nodes, nodes[2]).value)
            if status in ("Slave", "Master"):
                return
            self._clock.sleep(PTP_POLL)
        raise CameraError(
            f"camera {self.name!r} does not follow PTP within {PTP_LOCKS:g} s: its {nodes[2]} is {status}; does the "
            "network have a PTP master, and does its switch pass PTP on?"
        )

    def arm(self) -> None:
        """Drop what earlier edges exposed."""
        while (old := self._acquirer.try_fetch(timeout=DRAIN)) is not None:
            with old:
                pass
        self._armed = self._clock.now()

    def _set(self, node: str, value: float | str) -> None:
        """Set a setting of the camera. Raises CameraError where it lacks it or does not take the value."""
        try:
            getattr(self._nodes, node).value = value
        except Exception as error:  # genicam's own kinds, of which there are many
            raise CameraError(f"camera {self.name!r} does not take {node} = {value}: {error}") from error

    def grab(self) -> Frame:
        """Trigger an exposure, or where an edge does this wait for one, and for its image. Raises CameraError where
        none comes.
        """
        self._read_clock()
        before = self._armed if self.waits_for_edge else self._clock.now()
        if not self.waits_for_edge:
            self._nodes.TriggerSoftware.execute()
        triggered = self._clock.now()
        cause = (
            f"an edge at {self._settings.trigger}: is a strobe wired to it" if self.waits_for_edge else "its trigger"
        )
        try:
            buffer = self._acquirer.fetch(timeout=WAIT)
        except Exception as error:  # harvesters passes on whatever the producer raises
            raise CameraError(f"camera {self.name!r} gave no image in {WAIT:g} s after {cause}: {error}") from error
        if buffer is None:
            raise CameraError(f"camera {self.name!r} gave no image in {WAIT:g} s after {cause}")
        if self.waits_for_edge:
            triggered = self._clock.now()
        with buffer:
            image = self._image(buffer.payload.components[0])
            stamp = buffer.timestamp_ns * STAMP if buffer.timestamp_ns else None
        half = self._exposure() / 2
        if stamp is None:
            return Frame(image, (before + triggered) / 2 + half, max(triggered - before, 1e-3) / 2)
        restarts = self._offset.restarts
        self._offset.learn(before, stamp, self._clock.now())  # stamps are of the exposure's start, or later
        if self._settings.ptp and self._offset.restarts > restarts:
            raise CameraError(
                f"camera {self.name!r}: its stamps contradict those of the other cameras that keep time by PTP, or its "
                "own earlier ones: one of them does not follow the master"
            )
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
        """(height, width) or, in colours, (height, width, 3) BGR, uint8 or uint16, of a buffer's component, copied out
        of it. Raises CameraError for another size or format.
        """
        if (component.width, component.height) != self._size:
            raise CameraError(
                f"camera {self.name!r} gives {component.width} x {component.height} px, but rig.toml has "
                f"{self._size[0]} x {self._size[1]} px"
            )
        form = FORMAT.fullmatch(component.data_format)
        if form is None:
            raise CameraError(
                f"camera {self.name!r} sends {component.data_format}; set its pixel_format under [camera.capture] to "
                "Mono8, Mono10, Mono12, Mono16, BayerRG8 (GB, GR, BG; 10, 12, 16), RGB8 or BGR8"
            )
        kind, bits = form[1], int(form[2])
        shape = (component.height, component.width, *((3,) if kind in ("RGB", "BGR") else ()))
        image = np.array(component.data).reshape(shape)
        image = image.astype(np.uint8) if bits == 8 else image.astype(np.uint16) << (16 - bits)
        if kind == "RGB":
            return np.ascontiguousarray(image[..., ::-1])
        if not kind.startswith("Bayer"):
            return image
        import cv2

        return cast("Integers", cv2.cvtColor(image, getattr(cv2, f"COLOR_Bayer{BAYER[kind[5:]]}2BGR")))

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
        self._let_go()


def open_genicam_camera(
    name: str, serial: str, clock: Clock, size: tuple[int, int], settings: CaptureSettings = AS_IT_IS
) -> GenicamSource:
    """Open the GenICam camera with a serial number.
    Raises MissingLibrary without harvesters, CameraError where no such camera answers or it does not take a setting.
    """
    acquirer = HARVESTER.open(name, serial)
    try:
        return GenicamSource(name, acquirer, clock, size, settings, HARVESTER.close, HARVESTER.ptp)
    except BaseException:
        acquirer.destroy()
        HARVESTER.close()
        raise


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
