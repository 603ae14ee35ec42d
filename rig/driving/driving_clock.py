"""Clock for commands and exposures.

It has now and sleep: the system clock, and a simulated clock for tests.
"""

import time
from typing import Protocol


class Clock(Protocol):
    """A clock that can wait. Everything that waits takes one."""

    def now(self) -> float:
        """Seconds since the epoch, never running backwards."""

    def sleep(self, seconds: float) -> None:
        """Return when so many seconds have passed; at once for none or fewer."""


class SystemClock:
    """The computer's monotonic clock, related to the epoch once, when made: a correction of the wall clock does not
    bend it.
    """

    def __init__(self) -> None:
        self._epoch = time.time() - time.monotonic()

    def now(self) -> float:
        return self._epoch + time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(max(seconds, 0.0))


class SimulatedClock:
    """A clock that advances only when waited on. start : s"""

    def __init__(self, start: float = 0.0) -> None:
        self._now = float(start)

    def now(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        self._now += max(seconds, 0.0)
