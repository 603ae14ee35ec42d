"""Camera interface and its clock, synchronised grabbing of all cameras, exposure, and the check that a scene settled.

Each pair of readings of the host's clock, before and after something that the camera stamped, says that offset = host
- camera lies between them. Bounds of several meet in a narrower one (Cristian, Distributed Computing 3, 1989); old
bounds widen with the drift that two clocks may have.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from rig.array_and_json_types import Floats, Pixels
from rig.driving.clock import Clock
from rig.errors import RigError

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
        none.
        """
        futures = [self._pool.submit(self._one, source) for source in self.sources]
        errors = [error for error in (future.exception() for future in futures) if error is not None]
        for error in errors:
            if not isinstance(error, CameraError):
                raise error
        if errors:
            raise CameraError("; ".join(map(str, errors)))
        return {source.name: future.result() for source, future in zip(self.sources, futures)}

    def _one(self, source: Source) -> Frame:
        for k in range(self._tries):
            try:
                return source.grab()
            except CameraError as error:
                if k + 1 == self._tries:
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


def set_exposure_for_markers(
    source: Source, white_level: Callable[[Pixels], tuple[float, float]], start_exposure: float
) -> tuple[float, float]:
    """Set a camera's exposure such that markers do not clip; returns (exposure in s, white level of 255).

    white_level : (image) -> (level of the markers' white, of 255; share of their pixels that clip); start_exposure : s
    Raises CameraError where no exposure does it.
    """
    exposure = source.set_exposure(start_exposure)
    low, high = RANGE
    for _ in range(STEPS):
        level, clips = white_level(source.grab().image)
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


BLOCK = 8  # px; means over blocks this wide are compared, so that noise of pixels does not count
NOISES = 8.0  # standard deviations of a block's mean between two images at rest; the most of 1e5 blocks stay within 5
LARGEST_NOISE = 1.0  # grey levels of a block's mean, above which it is no noise
LEAST = 0.5  # grey levels below which nothing has changed
PAIRS = 2  # successive pairs of images that must not differ
READINGS = 5  # of the limbs that must agree
EVERY = 0.05  # s between readings
MOST = 30.0  # s after which what has not settled is an error


class NotSettled(RigError):
    """The platform does not come to rest; states by how much it still moved."""


@dataclass(frozen=True, slots=True)
class Settling:
    """by : "time", "images" or "limbs"; amount : s to wait, or m that the limbs' readings may differ; unused for
    images.
    """

    by: str
    amount: float

    def wait(
        self, clock: Clock, images: Callable[[], list[Pixels]] | None = None, limbs: Callable[[], Floats] | None = None
    ) -> None:
        """Return once the platform rests. images : one of each camera; limbs : (6,) m readings; whichever `by` asks
        for.

        Raises NotSettled after MOST seconds, ValueError where what it goes by is not given.
        """
        if self.by == "time":
            clock.sleep(self.amount)
        elif self.by == "images" and images is not None:
            _by_images(clock, images)
        elif self.by == "limbs" and limbs is not None:
            _by_limbs(clock, limbs, self.amount)
        else:
            raise ValueError(f"settling by {self.by} takes {self.by} to look at")


def parse_settling(text: str) -> Settling:
    """Settling parsed from text: "time:SECONDS", "images" or "limbs:METRES".
    Raises RigError for anything else.
    """
    by, _, amount = text.partition(":")
    try:
        value = float(amount) if amount else 0.0
    except ValueError:
        value = -1.0
    if by not in ("time", "images", "limbs") or not 0 <= value < np.inf or (by == "images") == bool(amount):
        raise RigError(f'settling takes "time:SECONDS", "images" or "limbs:METRES", got {text!r}')
    return Settling(by, value)


def image_difference_relative_to_noise(first_image: Pixels, second_image: Pixels) -> float:
    """Difference of two images of a camera relative to noise; above 1 the view has moved."""
    difference = np.abs(_blocks(first_image) - _blocks(second_image))
    noise = min(float(np.median(difference)) / 0.6745, LARGEST_NOISE)
    return float(difference.max()) / max(NOISES * noise, LEAST)


def _blocks(image: Pixels) -> Floats:
    """Means over blocks of an image, in 255ths of white."""
    grey = image if image.ndim == 2 else image[..., 1]  # green is most of what the eye calls grey
    height, width = (n - n % BLOCK for n in grey.shape)
    scale = 1.0 if image.dtype == np.uint8 else 1 / 257
    return grey[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).mean(axis=(1, 3)) * scale


def _by_images(clock: Clock, images: Callable[[], list[Pixels]]) -> None:
    start, before, still = clock.now(), images(), 0
    while still < PAIRS:
        now = images()
        most = max(image_difference_relative_to_noise(a, b) for a, b in zip(before, now))
        still, before = still + 1 if most <= 1 else 0, now
        if clock.now() - start > MOST and still < PAIRS:
            raise NotSettled(
                f"images still change after {MOST:g} s, {most:.1f} times the noise: does the "
                "platform move, or the light?"
            )


def _by_limbs(clock: Clock, limbs: Callable[[], Floats], tolerance: float) -> None:
    start = clock.now()
    last: list[Any] = []
    while True:
        last = [*last[1 - READINGS :], np.asarray(limbs(), float)]
        moved = np.ptp(last, axis=0)
        if len(last) == READINGS and (moved <= tolerance).all():
            return
        if clock.now() - start > MOST:
            raise NotSettled(
                f"limb {int(np.argmax(moved)) + 1} still moves by {moved.max() * 1e6:.2f} um after {MOST:g} s, "
                f"{tolerance * 1e6:.2f} um are allowed"
            )
        clock.sleep(EVERY)
