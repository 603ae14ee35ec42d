"""GenICam camera through harvesters.

GigE Vision and USB3 Vision: triggered by the run, or by an edge that another camera's strobe gives; hardware
timestamps, of one clock where cameras keep time by PTP.
Source: GenICam Standard Features Naming Convention 2.7, chapters Acquisition Control, Digital I/O, PTP Control
"""

import re
from collections.abc import Callable
from contextlib import suppress
from typing import cast

import numpy as np

from rig.array_and_json_types import Integers
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import CameraError, ClockOffset, Frame
from rig.driving.cameras.genicam_harvester_interface_and_camera_discovery import (
    HARVESTER,
    Acquirer,
    Buffer,
    ImageComponent,
    Number,
    error_text,
)
from rig.driving.driving_clock import Clock
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
EXPOSURE = ("ExposureTime", "ExposureTimeAbs")  # us; the second name is of cameras before SFNC 2.0
GAIN = ("Gain", "GainAbs")  # dB
FORMAT = re.compile(r"(Mono|Bayer(?:RG|GB|GR|BG)|RGB|BGR)(8|10|12|14|16)")
BAYER = {"RG": "RGGB", "GB": "GBRG", "GR": "GRBG", "BG": "BGGR"}  # first two of a row, and all four as OpenCV has it


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
        self._nodes = acquirer.remote_device.node_map
        self._exposure_node = self._name_of("exposure time", EXPOSURE)
        if settings.pixel_format:  # first, as white balance is there for colours alone
            self._set("PixelFormat", settings.pixel_format)
        for node, value in (
            ("AcquisitionMode", "Continuous"),
            ("TriggerSelector", "FrameStart"),
            ("TriggerMode", "On"),
            ("TriggerSource", "Software"),
            ("ExposureMode", "Timed"),
            ("ExposureAuto", "Off"),
            ("BalanceWhiteAuto", "Off"),  # or colours change from frame to frame
        ):
            self._set_available(node, value)
        if settings.gain is not None:
            self._set_available("GainAuto", "Off")
            self._set(self._name_of("gain in dB", GAIN), settings.gain)
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

    def _name_of(self, what: str, names: tuple[str, ...]) -> str:
        """Which of the names of a setting the camera has. Raises CameraError where it has none of them."""
        found = next((name for name in names if hasattr(self._nodes, name)), None)
        if found is None:
            raise CameraError(f"camera {self.name!r} has no {what}: none of {', '.join(names)}")
        return found

    def _set(self, node: str, value: float | str) -> None:
        """Set a setting of the camera. Raises CameraError where it lacks it or does not take the value."""
        if not hasattr(self._nodes, node):
            raise CameraError(f"camera {self.name!r} does not take {node} = {value}: it has no {node}")
        try:
            getattr(self._nodes, node).value = value
        except Exception as error:  # genicam's own kinds, of which there are many
            raise CameraError(f"camera {self.name!r} does not take {node} = {value}: {error_text(error)}") from error

    def _set_available(self, node: str, value: str) -> None:
        """Set a setting unless the camera lacks it, as it is or in its present state; white balance is not there where
        images are grey. Raises CameraError where it is there and does not take the value.
        """
        try:
            if getattr(self._nodes, node).value == value:
                return
        except Exception:  # genicam: it is not there, or cannot be read in this state
            return
        self._set(node, value)

    def grab(self) -> Frame:
        """Trigger an exposure, or where an edge does this wait for one, and for its image. Raises CameraError where
        none comes.
        """
        try:
            return self._triggered_frame()
        except CameraError:
            raise
        except Exception as error:  # genicam's own kinds, as of a camera that is unplugged
            raise CameraError(
                f"camera {self.name!r} does not answer; is it plugged in, and free? {error_text(error)}"
            ) from error

    def _triggered_frame(self) -> Frame:
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
            raise CameraError(
                f"camera {self.name!r} gave no image in {WAIT:g} s after {cause}: {error_text(error)}"
            ) from error
        if buffer is None:
            raise CameraError(f"camera {self.name!r} gave no image in {WAIT:g} s after {cause}")
        if self.waits_for_edge:
            triggered = self._clock.now()
        with buffer:
            image = self._image(buffer.payload.components[0])
            stamp = _stamp(buffer)
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
        if component.data.size != np.prod(shape):
            raise CameraError(
                f"camera {self.name!r} sent {component.data.size} of the {np.prod(shape)} values of an image; are "
                "packets lost, or rows padded?"
            )
        image = np.array(component.data).reshape(shape)
        image = image.astype(np.uint8) if bits == 8 else image.astype(np.uint16) << (16 - bits)
        if kind == "RGB":
            return np.ascontiguousarray(image[..., ::-1])
        if not kind.startswith("Bayer"):
            return image
        import cv2

        return cast("Integers", cv2.cvtColor(image, getattr(cv2, f"COLOR_Bayer{BAYER[kind[5:]]}2BGR")))

    def _exposure(self) -> float:
        return float(self._exposure_time().value) * 1e-6

    def _exposure_time(self) -> Number:
        return cast("Number", getattr(self._nodes, self._exposure_node))

    def set_exposure(self, seconds: float) -> float:
        """Expose for so long, within what the camera can."""
        node = self._exposure_time()
        node.value = min(max(seconds * 1e6, node.min), node.max)
        return self._exposure()

    def close(self) -> None:
        """Stop and let go of the camera, also where it is gone and answers neither."""
        try:
            for step in (self._acquirer.stop, self._acquirer.destroy):
                with suppress(Exception):  # genicam's own kinds, of a camera that is gone
                    step()
        finally:
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
    except BaseException as error:
        with suppress(Exception):  # a camera that is gone: what was wrong before is reported
            acquirer.destroy()
        HARVESTER.close()
        if isinstance(error, CameraError) or not isinstance(error, Exception):
            raise
        raise CameraError(f"camera {name!r}: {error_text(error)}") from None


def _stamp(buffer: Buffer) -> float | None:
    """When a buffer's exposure began, s on its camera's clock; None where the camera stamps none."""
    try:
        nanoseconds = buffer.timestamp_ns
    except Exception:  # genicam: producers before GenTL 1.5 know ticks alone
        try:
            return buffer.timestamp / buffer.timestamp_frequency or None
        except Exception:  # genicam, or a frequency of 0: the trigger's time is used
            return None
    return nanoseconds * STAMP if nanoseconds else None
