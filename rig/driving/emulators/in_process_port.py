"""A port straight to an emulator in the same process: nothing sleeps, the clock goes on to when something comes."""

from rig.driving.clock import SimulatedClock
from rig.driving.emulators.controller_emulator import Emulator

INSTANT = 1e-6  # s; a sum of times may round to just before


class EmulatorPort:
    """See rig.driving.controller_link.Port. emulator : its clock must be the one given."""

    def __init__(self, emulator: Emulator, clock: SimulatedClock) -> None:
        self._emulator, self._clock = emulator, clock
        emulator.due()  # what was said before anybody listened is gone, and a cut line raises

    def write(self, data: bytes) -> None:
        self._emulator.receive(data)

    def read(self, until: float) -> bytes:
        while not (data := self._emulator.due()):
            if self._clock.now() >= until:
                return b""
            come = self._emulator.next()
            self._clock.sleep(max(min(until, until if come is None else come) - self._clock.now(), 0.0) + INSTANT)
        return data

    def close(self) -> None:
        """Nothing is held."""
