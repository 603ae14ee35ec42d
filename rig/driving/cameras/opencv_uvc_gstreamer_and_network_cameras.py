"""OpenCV cameras: UVC, GStreamer and network.

Fresh frames with driver timestamps; check of GStreamer pipelines.
"""

from __future__ import annotations

import itertools
import math
import re
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TYPE_CHECKING, TypeVar, cast

from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    UNIFORM,
    CameraError,
    ClockOffset,
    Frame,
)
from rig.driving.driving_clock import Clock
from rig.model.design import AS_IT_IS, CaptureSettings

READING = re.compile(r"(?!wrapper)[a-z0-9]+src")
CONVERTING = re.compile(
    r"[a-z0-9]+(dec|depay|parse|demux|convert|convertscale|conv|postproc)|avdec_[a-z0-9]+|decodebin3?|bayer2rgb|"
    r"capsfilter|queue|rtpjitterbuffer|video(scale|rate|flip|crop|balance|box)|deinterlace"
)
END = "appsink"
SETTING = re.compile(r"[A-Za-z][A-Za-z0-9_-]*=[^\s!\"'\\()<>{}\[\];]+")
VALUE = r"(\([a-z]+\))?[A-Za-z0-9_.:/+-]+"
CAPS = re.compile(rf"(video|image)/[a-z0-9.+-]+(\(memory:[A-Za-z]+\))?(\s*,\s*[a-z-]+\s*=\s*{VALUE})*")


def gstreamer_pipeline_problem(pipeline: str) -> str | None:
    """Problem of a GStreamer pipeline as text.

    None where it only reads, decodes, converts and ends in appsink.

    Elements are known by name, settings are NAME=VALUE without quotes or blanks, what is asked of the video is as
    video/x-raw,width=640
    """
    parts = [part.strip() for part in pipeline.split("!")]
    for number, part in enumerate(parts):
        if CAPS.fullmatch(part) and 0 < number < len(parts) - 1:
            continue
        element, *settings = part.split() or [""]
        last = number == len(parts) - 1
        if last and element != END:
            return f"ends in {element!r}, and must end in {END}"
        if not last and ("sink" in element or not (READING.fullmatch(element) or CONVERTING.fullmatch(element))):
            return (
                f"names {element!r}; only elements that read, decode or convert images are opened, since others "
                "may write files"
            )
        wrong = next((one for one in settings if not SETTING.fullmatch(one)), None)
        if wrong is not None:
            return f"has {wrong!r} after {element}, which is no setting NAME=VALUE"
    mosaics = [number for number, part in enumerate(parts) if part.startswith("video/x-bayer")]
    if mosaics and "bayer2rgb" not in [part.split()[0] for part in parts[mosaics[-1] :]]:
        return f"sends a mosaic of colours, which is no image: add bayer2rgb ! videoconvert after {parts[mosaics[-1]]}"
    return None if len(parts) > 1 else f"must name an image source, then ! {END}"


if TYPE_CHECKING:
    from cv2 import VideoCapture

    from rig.array_and_json_types import Integers

FLUSHED = 8  # frames that may wait in a driver's queue
WAIT = 5.0  # s without a frame after which a camera counts as gone
OPENING, READING_TIME = 10_000, 5_000  # ms: a pipeline or network camera to open; a network camera to send a frame
MANUAL = 1  # V4L2_EXPOSURE_MANUAL
BLOCKED = 2e-3  # s; a frame that was not waiting in the queue takes longer to come
UVC_STEP = 1e-4  # s; V4L2's exposure_time_absolute counts these


class VideoSource:
    """A camera that OpenCV opens. Without stamps of its own, an image was exposed between the one before it and its
    arrival.
    """

    def __init__(
        self,
        name: str,
        capture: VideoCapture | GuardedCapture,
        clock: Clock,
        size: tuple[int, int],
        uvc: bool = True,
        settings: CaptureSettings = AS_IT_IS,
        stamped: bool = True,
        queue: int | None = FLUSHED,
    ) -> None:
        """capture : an open cv2.VideoCapture; size : (width, height) px that its images must have; uvc : whether it
        takes UVC's controls; settings : of those; stamped : whether its times, where it has any, are of a clock that
        stamps exposures; queue : frames that may wait, None of a stream, of which any number may: WAIT bounds the time
        to a fresh one. Raises CameraError where the camera does not take a setting.
        """
        import cv2

        self.name, self.can_set_exposure = name, uvc
        self._cv2, self._capture, self._clock, self._size, self._offset = cv2, capture, clock, size, ClockOffset()
        self._exposure, self._stamped, self._queue = 0.0, stamped, queue
        if settings.focus is not None:
            self._set("focus", cv2.CAP_PROP_FOCUS, settings.focus, cv2.CAP_PROP_AUTOFOCUS)
        if settings.white_balance is not None:
            self._set("white balance", cv2.CAP_PROP_WB_TEMPERATURE, settings.white_balance, cv2.CAP_PROP_AUTO_WB)
        if settings.gain is not None:
            self._set("gain", cv2.CAP_PROP_GAIN, settings.gain)

    def _set(self, name: str, control: int, value: float, automatic: int | None = None) -> None:
        """Set a control of the camera, its automatic one off. Raises CameraError where it is not so afterwards."""
        if automatic is not None:
            self._capture.set(automatic, 0)
        accepted = self._capture.set(control, value)
        if not accepted or abs(self._capture.get(control) - value) > 0.5:
            raise CameraError(
                f"camera {self.name!r} does not take a {name} of {value:g}; it has {self._capture.get(control):g}"
            )

    def grab(self) -> Frame:
        """A frame exposed after this call: what waits in the driver's queue is let go by. Raises CameraError where none
        comes.
        """
        began, last = self._clock.now(), None
        most = None if self._queue is None else self._queue + 3
        for _ in itertools.repeat(None) if most is None else range(most):
            before = self._clock.now()
            if not self._capture.grab():
                raise CameraError(f"camera {self.name!r} gives no frame; is it plugged in, and free?")
            after = self._clock.now()
            if after - began > WAIT:
                raise CameraError(f"camera {self.name!r} gave no fresh frame in {after - began:.1f} s")
            last, (begin, t, sigma) = after if after - before >= BLOCKED else None, self._time(before, after, last)
            if begin >= began:
                return Frame(self._image(), t, sigma)
        raise CameraError(
            f"camera {self.name!r} gave {most} frames, none of them known to be exposed after the request"
        )

    def _time(self, before: float, after: float, last: float | None) -> tuple[float, float, float]:
        """(earliest start, t, sigma) s of the exposure of the frame just grabbed, between two readings of the clock;
        start -inf if unknown.

        last : s, when the frame before it arrived, or None. A frame for which grabbing had to wait arrived then and
            there.
        """
        blocked, stamp = after - before >= BLOCKED, float(self._capture.get(self._cv2.CAP_PROP_POS_MSEC)) / 1e3
        if stamp <= 0 or not self._stamped:  # exposed between the arrival of the frame before it and its own
            return (
                (last, (last + after) / 2, (after - last) / UNIFORM)
                if blocked and last is not None
                else (-math.inf, after, math.inf)
            )
        if blocked:
            self._offset.learn(before, stamp, after)
        if self._offset.bound is None:
            return -math.inf, after, math.inf
        end, sigma = self._offset.host(
            stamp, after
        )  # drivers stamp what arrives, at the exposure's end or somewhat later
        return end - self._exposure, end - self._exposure / 2, math.hypot(sigma, self._exposure / UNIFORM)

    def _image(self) -> Integers:
        good, image = self._capture.retrieve()
        if not good or image is None:
            raise CameraError(f"camera {self.name!r}: a frame could not be decoded")
        if image.ndim == 3 and image.shape[2] != 3:
            raise CameraError(
                f"camera {self.name!r} gives {image.shape[2]} values for each pixel, neither grey nor colours; put "
                f"videoconvert ! video/x-raw,format=BGR before {END}"
            )
        if (image.shape[1], image.shape[0]) != self._size:
            raise CameraError(
                f"camera {self.name!r} gives {image.shape[1]} x {image.shape[0]} px, but rig.toml has "
                f"{self._size[0]} x {self._size[1]} px"
            )
        return cast("Integers", image)

    def set_exposure(self, seconds: float) -> float:
        """Turn UVC's automatic exposure off and expose for so long (steps of 0.1 ms). Raises CameraError where the
        camera does not take it.
        """
        cv2 = self._cv2
        steps = max(1, round(seconds / UVC_STEP))
        self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL)
        if not self._capture.set(cv2.CAP_PROP_EXPOSURE, steps):
            raise CameraError(f"camera {self.name!r} does not take an exposure of {seconds * 1e3:g} ms")
        self._exposure = steps * UVC_STEP
        return self._exposure

    def close(self) -> None:
        """Release the device."""
        self._capture.release()


class GuardedCapture:
    """A cv2.VideoCapture of GStreamer, which may wait for a frame without an end. After WAIT s it counts as gone; the
    call that waits stays in a thread that ends with the process, and nothing is called any more.
    """

    def __init__(self, capture: VideoCapture) -> None:
        self._capture, self._gone = capture, False

    def grab(self) -> bool:
        """Whether a frame came."""
        found = None if self._gone else _result_within(WAIT, self._capture.grab)
        self._gone = found is None
        return bool(found)

    def retrieve(self) -> tuple[bool, Integers | None]:
        """Whether the frame was decoded, and the frame."""
        return cast("tuple[bool, Integers | None]", self._capture.retrieve())

    def get(self, control: int) -> float:
        """A control's value."""
        return float(self._capture.get(control))

    def set(self, control: int, value: float) -> bool:
        """Whether a control was set."""
        return bool(self._capture.set(control, value))

    def release(self) -> None:
        """Let go of the pipeline."""
        if not self._gone:
            self._capture.release()


T = TypeVar("T")


def _result_within(seconds: float, call: Callable[[], T]) -> T | None:
    """What a call returns, None where it takes longer. Raises what the call raises."""
    result: Future[T] = Future()

    def run() -> None:
        try:
            result.set_result(call())
        except Exception as error:
            result.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return result.result() if wait([result], seconds).done else None  # a call may raise TimeoutError itself


def open_gstreamer_camera(name: str, pipeline: str, clock: Clock, size: tuple[int, int]) -> VideoSource:
    """Open a camera by its GStreamer pipeline.

    It ends in appsink.
    size : (width, height) px, as rig.toml has them. Raises CameraError where it does not open, and for a pipeline that
    may write (see gstreamer_pipeline_problem).
    """
    import cv2

    wrong = gstreamer_pipeline_problem(pipeline)
    if wrong is not None:
        raise CameraError(f"camera {name!r}: gstreamer:{pipeline} {wrong}")
    if not cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER):  # others list it as a plug-in that is not there
        raise CameraError(f"camera {name!r}: this build of OpenCV has no GStreamer; Debian's python3-opencv has")
    newest = pipeline if re.search(rf"{END}.*\sdrop=", pipeline) else f"{pipeline} drop=true"  # else old frames wait
    # of a pipeline without one of its elements, OpenCV waits for the first frame without an end
    capture = _result_within(OPENING / 1e3, lambda: cv2.VideoCapture(newest, cv2.CAP_GSTREAMER))
    if capture is None or not capture.isOpened():
        raise CameraError(
            f"camera {name!r}: gstreamer:{pipeline} cannot be opened; `gst-launch-1.0 "
            f"{pipeline.rpartition('!')[0].strip()} ! fakesink` states why"
        )
    # its times are where the pipeline stands, not when the frame was exposed, which is earlier by some frames
    return VideoSource(name, GuardedCapture(capture), clock, size, uvc=False, stamped=False)


def open_uvc_camera(
    name: str, place: str, clock: Clock, size: tuple[int, int], settings: CaptureSettings = AS_IT_IS
) -> VideoSource:
    """Open a UVC camera by its device's number or path.

    size : (width, height) px, as rig.toml has them. Raises CameraError where it does not open or does not take a
    setting.
    """
    import cv2

    device = int(place) if place.isdigit() else place
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)
    if settings.pixel_format:  # before the size, which is one of this format's
        code = cv2.VideoWriter.fourcc(*settings.pixel_format)
        if not capture.set(cv2.CAP_PROP_FOURCC, code) or int(capture.get(cv2.CAP_PROP_FOURCC)) != code:
            capture.release()
            raise CameraError(f"camera {name!r} does not send {settings.pixel_format}")
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    if not capture.isOpened():
        capture.release()
        raise CameraError(f"camera {name!r}: uvc:{place} cannot be opened; is it there, and free?")
    try:
        return VideoSource(name, capture, clock, size, uvc=True, settings=settings)
    except CameraError:
        capture.release()
        raise


def open_network_camera(name: str, url: str, clock: Clock, size: tuple[int, int]) -> VideoSource:
    """Open a network camera by its URL.

    The URL is http, https (a stream of JPEG images) or rtsp.
    size : (width, height) px, as rig.toml has them. Raises CameraError where it does not answer.
    """
    import cv2

    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPENING, cv2.CAP_PROP_READ_TIMEOUT_MSEC, READING_TIME]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, limits)
    if not capture.isOpened():
        capture.release()
        raise CameraError(f"camera {name!r}: {_without_password(url)} sends no video; is the address right?")
    return VideoSource(name, capture, clock, size, uvc=False, stamped=False, queue=None)


def _without_password(url: str) -> str:
    """A URL as messages show it."""
    return re.sub(r"//[^/@]*@", "//..@", url)
