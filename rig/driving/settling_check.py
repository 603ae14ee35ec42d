"""Settling check before an exposure.

By time, until images stop changing, or until limb readings agree.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.array_and_json_types import Floats, Pixels
from rig.driving.clock import Clock
from rig.errors import RigError

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
    """Settling parsed from text.

    "time:SECONDS", "images" or "limbs:METRES".
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
    """Difference of two images of a camera relative to noise.

    Above 1 the view has moved.
    """
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
