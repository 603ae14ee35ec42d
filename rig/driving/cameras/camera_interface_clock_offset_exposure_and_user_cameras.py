"""Camera interface, clock offset, exposure, and cameras of the user's own.

The offset of a camera's clock, and exposure for markers.

Each pair of readings of the host's clock, before and after something that the camera stamped, says that offset = host
- camera lies between them. Bounds of several meet in a narrower one (Cristian, Distributed Computing 3, 1989); old
bounds widen with the drift that two clocks may have.

A user's own camera is a class in a file or package, or a program that is run for each image.
"""

import math
import shlex
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from rig.array_and_json_types import Pixels
from rig.driving.driving_clock import Clock
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import (
    load_user_class_and_its_file,
    user_class_error,
    wrap_user_call_to_locate_errors,
)
from rig.errors import FileError, RigError
from rig.model.design import Camera
from rig.recording.exposures_and_image_files import decode_image

DRIFT = 1e-4  # s per s; two quartz clocks differ by less
UNIFORM = math.sqrt(12.0)  # width of an even spread over its standard deviation


@dataclass(frozen=True, slots=True)
class ClockOffsetBound:
    """offset lies in low .. high (s), as known at host time t."""

    t: float
    low: float
    high: float

    def at(self, t: float) -> "ClockOffsetBound":
        """The same at a later time, wider by what the clocks may have drifted."""
        more = DRIFT * (t - self.t)
        return ClockOffsetBound(t, self.low - more, self.high + more)


class ClockOffset:
    """The offset host - camera of one camera's clock, learnt from its stamps. `restarts` counts how often its clock was
    found set anew.
    """

    def __init__(self) -> None:
        self.bound: ClockOffsetBound | None = None
        self.restarts = 0

    def learn(self, before: float, stamp: float, after: float) -> None:
        """One stamp of the camera's clock (s), taken between two readings of the host's (s). Raises RigError for
        readings out of order.
        """
        if after < before:
            raise RigError(f"the host's clock ran backwards about a camera's stamp: {before!r} s, then {after!r} s")
        fresh = ClockOffsetBound(after, before - stamp, after - stamp)
        if self.bound is not None:
            old = self.bound.at(after)
            low, high = max(old.low, fresh.low), min(old.high, fresh.high)
            if low <= high:
                self.bound = ClockOffsetBound(after, low, high)
                return
            self.restarts += 1  # no offset satisfies both: the camera's clock was set anew
        self.bound = fresh

    def host(self, stamp: float, now: float) -> tuple[float, float]:
        """(t, sigma) s: a stamp of the camera on the host's clock, and how well that is known. Raises RigError before
        any stamp.
        """
        if self.bound is None:
            raise RigError("the offset between the camera's clock and the host's is not known yet")
        bound = self.bound.at(max(now, self.bound.t))
        return stamp + (bound.low + bound.high) / 2, (bound.high - bound.low) / UNIFORM


class CameraError(RigError):
    """A camera that gives no image, or one that cannot be used; names the camera and its message."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """image : (height, width) or (height, width, 3), uint8 or uint16; t : s on the host's clock, middle of the exposure
    t_sigma : s, standard deviation of that."""

    image: Pixels
    t: float
    t_sigma: float


class Source(Protocol):
    """A camera that is open. `can_set_exposure` says whether `set_exposure` does anything."""

    name: str
    can_set_exposure: bool

    def grab(self) -> Frame:
        """A frame whose exposure began after this call. Raises CameraError where none comes in time."""

    def set_exposure(self, seconds: float) -> float:
        """Have images exposed for so long from now on; returns what the camera made of it, s."""

    def close(self) -> None:
        """Let go of the camera."""


@runtime_checkable
class EdgeTriggered(Protocol):
    """A camera that an electrical edge may expose. waits_for_edge : whether one does"""

    waits_for_edge: bool

    def arm(self) -> None:
        """Drop what earlier edges exposed: the next image is of an edge after this."""


class StampDifferences:
    """By how much cameras expose after the first of them, as their reconciled stamps say."""

    def __init__(self) -> None:
        self._after: dict[tuple[str, str], list[tuple[float, float]]] = {}

    def add(self, frames: dict[str, Frame]) -> None:
        """The cameras of one more frame."""
        names = list(frames)
        for name in names[1:]:
            frame, first = frames[name], frames[names[0]]
            row = frame.t - first.t, math.hypot(frame.t_sigma, first.t_sigma)
            self._after.setdefault((names[0], name), []).append(row)

    def lines(self) -> list[str]:
        """A sentence for each camera but the first."""
        found = []
        for (first, name), rows in self._after.items():
            after, known = np.array(rows).T
            found.append(
                f"{name} exposed {after.mean() * 1e3:+.3f} ms after {first} in the mean of {len(rows)} frames, between "
                f"{after.min() * 1e3:+.3f} and {after.max() * 1e3:+.3f}; their clocks are compared to "
                f"{np.sqrt((known**2).mean()) * 1e3:.3f} ms (standard deviation)"
            )
        return found


TRIES = 3
PAUSE = 0.1  # s before trying again, doubled each time


class SynchronisedCameras:
    """All cameras of a rig. retried : (camera, what it said) of grabs that were tried again."""

    def __init__(self, sources: tuple[Source, ...], clock: Clock, tries: int = TRIES) -> None:
        if not sources:
            raise CameraError("there is no camera to take a frame with")
        self.sources = tuple(sources)
        self.retried: list[tuple[str, str]] = []
        self._clock, self._tries = clock, tries
        self._pool = ThreadPoolExecutor(len(sources))

    def grab(self) -> dict[str, Frame]:
        """{camera: Frame}, exposed together as nearly as their triggers allow. Raises CameraError for all that gave
        none. Where an edge exposes some, all are armed before the others are triggered, and all are tried again.
        """
        armed = [source for source in self.sources if isinstance(source, EdgeTriggered) and source.waits_for_edge]
        for k in range(self._tries if armed else 1):
            for source in armed:
                source.arm()
            try:
                return self._all_frames(1 if armed else self._tries)
            except CameraError as error:
                if not armed or k + 1 == self._tries:
                    raise
                self.retried.append((", ".join(source.name for source in self.sources), str(error)))
                self._clock.sleep(PAUSE * 2**k)
        raise AssertionError("unreachable: the last try returns or raises")

    def _all_frames(self, tries: int) -> dict[str, Frame]:
        """{camera: Frame} of all, each tried so often by itself."""
        futures = [self._pool.submit(self._one, source, tries) for source in self.sources]
        errors = [error for error in (future.exception() for future in futures) if error is not None]
        for error in errors:
            if not isinstance(error, CameraError):
                raise error
        if errors:
            raise CameraError("; ".join(map(str, errors)))
        return {source.name: future.result() for source, future in zip(self.sources, futures)}

    def _one(self, source: Source, tries: int) -> Frame:
        for k in range(tries):
            try:
                return source.grab()
            except CameraError as error:
                if k + 1 == tries:
                    raise
                self.retried.append((source.name, str(error)))
                self._clock.sleep(PAUSE * 2**k)
        raise AssertionError("unreachable: the last try returns or raises")

    def close(self) -> None:
        """Let go of all cameras."""
        self._pool.shutdown()
        for source in self.sources:
            source.close()


WHITE = 200.0  # of 255, where the markers' white is brought to
WHITE_SLACK = 0.1  # share of that which is off without harm
CLIPPED = 250.0  # of 255; brighter than this may be anything
CLIPS = 0.005  # share of the markers' pixels that may be brighter
STEPS = 8  # of setting and looking
RANGE = (1e-5, 1.0)  # s


def set_marker_exposure_and_measure_white(
    source: Source, measure_white_level: Callable[[Pixels], tuple[float, float]], start_exposure: float
) -> tuple[float, float]:
    """Set a camera's exposure such that markers do not clip; return it and the white level.

    measure_white_level : (image) -> (level of the markers' white, of 255; share of their pixels that clip);
    start_exposure : s
    Returns (exposure in s, white level of 255)
    Raises CameraError where no exposure does it.
    """
    exposure = source.set_exposure(start_exposure)
    low, high = RANGE
    for _ in range(STEPS):
        level, clips = measure_white_level(source.grab().image)
        bright = clips > CLIPS or level >= CLIPPED
        if not bright and abs(level - WHITE) <= WHITE_SLACK * WHITE:
            return exposure, level
        if bright:
            high = exposure
        elif level < WHITE:
            low = exposure
        wanted = exposure / 2 if bright else exposure * WHITE / max(level, 1.0)
        if not low < wanted < high:
            wanted = (low * high) ** 0.5
        before, exposure = exposure, source.set_exposure(wanted)
        if exposure == before:
            break
    if not bright and level > WHITE / 4:
        return exposure, level  # as good as this camera's steps allow
    raise CameraError(
        f"camera {source.name!r}: no exposure found at which markers are bright and do not clip; at "
        f"{exposure * 1e3:.3g} ms white is "
        f"at {level:.0f} of 255 and {clips:.1%} clip: change the light or the aperture"
    )


T = TypeVar("T")
GROUP = "rig.cameras"  # of entry points
WAIT = 30.0  # s that a program may take for an image
ELSEWHERE = 5.0  # s by which a stamp may lie outside the call: clocks may differ, and exposures in motion tell by what
SHOWN = 300  # characters of what a program printed, in messages


class UserCamera:
    """Base class of a camera of the user's own. camera : its name, width and height as rig.toml states them."""

    can_set_exposure = False

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def grab(self) -> Pixels | tuple[Pixels, float, float]:
        """Image (height, width) or (height, width, 3) in uint8 or uint16, exposed after this call and before it
        returns; or (image, t, t_sigma) with the middle of its exposure, s since 1970, and how well that is known, s.
        Raises CameraError where there is none.
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
        kind, path = load_user_class_and_its_file(str(camera.source), UserCamera, GROUP, "camera")
        if kind.grab is UserCamera.grab:
            raise user_class_error(path, kind, "lacks grab, which returns an image")
        self.name, self.can_set_exposure, self._camera, self._clock = camera.name, kind.can_set_exposure, camera, clock
        self._owner, self._path = kind, path
        self._user = self._guarded(kind)(camera)

    def _guarded(self, call: Callable[..., T]) -> Callable[..., T]:
        return wrap_user_call_to_locate_errors(call, self._path, CameraError, self._owner.__name__)

    def grab(self) -> Frame:
        before = self._clock.now()
        given = self._guarded(self._user.grab)()
        after = self._clock.now()
        if not isinstance(given, tuple):
            return Frame(
                require_image_size_and_type(given, self._camera), (before + after) / 2, (after - before) / UNIFORM
            )
        image, t, sigma = self._guarded(_stamped)(given)
        if not (before - ELSEWHERE <= t <= after + ELSEWHERE and 0 <= sigma < ELSEWHERE):
            raise CameraError(
                f"camera {self.name!r} states t = {t:.3f} s with t_sigma = {sigma:g} s of an image requested "
                f"at {before:.3f} s and was there at {after:.3f} s: is t in seconds since 1970?"
            )
        return Frame(require_image_size_and_type(image, self._camera), t, sigma)

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
        before = self._clock.now()
        try:
            done = subprocess.run(self._words, capture_output=True, timeout=self._wait, stdin=subprocess.DEVNULL)
        except OSError as error:
            raise CameraError(f"camera {self.name!r}: {self._words[0]} cannot be run: {error.strerror}") from None
        except subprocess.TimeoutExpired:
            raise CameraError(f"camera {self.name!r}: {self._words[0]} gave no image in {self._wait:g} s") from None
        after = self._clock.now()
        if done.returncode:
            message = done.stderr.decode("utf-8", "replace").strip()[-SHOWN:]
            raise CameraError(f"camera {self.name!r}: {self._words[0]} ended with {done.returncode}: {message}")
        try:
            image = decode_image(done.stdout, Path(f"output of {self._words[0]}"))
        except FileError as error:
            raise CameraError(f"camera {self.name!r}: {error}") from None
        return Frame(require_image_size_and_type(image, self._camera), (before + after) / 2, (after - before) / UNIFORM)

    def set_exposure(self, seconds: float) -> float:
        """Raises CameraError: the program exposes."""
        raise CameraError(f"camera {self.name!r} is a command; its exposure is set by its program")

    def close(self) -> None:
        """Nothing is held open."""


def _stamped(given: tuple[Pixels, float, float]) -> tuple[Pixels, float, float]:
    image, t, sigma = given
    return image, float(t), float(sigma)


def require_image_size_and_type(image: object, camera: Camera) -> Pixels:
    """Require that an image of a user's program has the camera's size and a known type, and return it.

    Raises CameraError for another size or type.
    """
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3):
        what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise CameraError(f"camera {camera.name!r} gives {what}, not an array of uint8 or uint16")
    if image.ndim == 3 and image.shape[2] != 3:
        raise CameraError(
            f"camera {camera.name!r} gives {image.shape[2]} values for each pixel, neither grey nor three colours"
        )
    expected = (camera.height, camera.width, 3)[: image.ndim]
    if image.shape != expected:
        raise CameraError(
            f"camera {camera.name!r} gives {image.shape[1]} x {image.shape[0]} px, but rig.toml has "
            f"{camera.width} x {camera.height} px"
        )
    return image
