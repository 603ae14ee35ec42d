"""Camera interface (Source, Frame, CameraError), and the offset of a camera's clock to the host's clock.

Each pair of readings of the host's clock, before and after something that the camera stamped, says that offset = host
- camera lies between them. Bounds of several meet in a narrower one (Cristian, Distributed Computing 3, 1989); old
bounds widen with the drift that two clocks may have.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from rig.array_types import Pixels
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
    """A camera that gives no image, or one that cannot be used; names the camera and what it said."""


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
