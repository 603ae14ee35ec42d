"""What a camera is to the rest of the house: something that grabs a frame, and when the frame was exposed on the host's
clock.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rig.errors import RigError


class CameraError(RigError):
    """A camera that gives no image, or one that cannot be used; names the camera and what it said."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """image : (height, width) or (height, width, 3), uint8 or uint16; t : s on the host's clock, middle of the exposure
    t_sigma : s, standard deviation of that."""

    image: np.ndarray
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
