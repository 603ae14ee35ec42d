"""Sensors read from a port: a line of numbers per reading."""

from collections.abc import Callable

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.clock import Clock
from rig.driving.request_and_answer_exchange_with_controller import Port
from rig.driving.serial_port import SerialPort
from rig.errors import NoAnswer
from rig.formats.number_parsing_and_rounding import parse_numbers
from rig.model.design import SensorPort

WAIT = 2.0  # s for a line
LONGEST = 4096  # bytes


class SensorReader:
    """An open port with sensors. stated : SensorPort of the rig.toml; opener : makes the port, by default the one that
    it names
    """

    def __init__(self, stated: SensorPort, clock: Clock, opener: Callable[[], Port] | None = None) -> None:
        self._stated, self._clock = stated, clock
        self._port = opener() if opener else SerialPort(stated.port, stated.baudrate, clock)

    def read(self) -> dict[str, float]:
        """{channel: value} of a line that came after this call. Raises NoAnswer where none comes, or one that is not
        these channels.
        """
        stated, rest, end = self._stated, b"", self._clock.now() + WAIT
        self._port.read(self._clock.now())  # what came before is old
        if stated.ask:
            self._port.write(stated.ask.encode() + b"\n")
        skip = not stated.ask  # a line under way may have begun before
        while True:
            if self._clock.now() >= end:
                raise NoAnswer(f"the sensors at {stated.port} sent no line in {WAIT:g} s")
            rest += self._port.read(end)
            *lines, rest = rest.replace(b"\r", b"\n").split(b"\n")
            lines = [line for line in lines if line.strip()]
            if len(rest) > LONGEST:
                raise NoAnswer(f"the sensors at {stated.port} send no lines: {rest[:40]!r} ..")
            if lines and skip:
                lines, skip = lines[1:], False
            if lines:
                return self._values(lines[-1])

    def limbs(self) -> Floats:
        """(6,) m, what the measuring limbs read."""
        values = self.read()
        return np.array([values[f"m{i + 1}"] for i in range(6)])

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def _values(self, line: bytes) -> dict[str, float]:
        cells = line.decode("latin-1").replace(",", " ").replace(";", " ").split()
        try:
            values = parse_numbers(cells)
        except ValueError:
            values = []
        if len(values) != len(self._stated.channels) or not np.isfinite(values).all():
            raise NoAnswer(
                f"the sensors at {self._stated.port} sent {line[:80]!r}; [sensors] channels has "
                f"{len(self._stated.channels)} numbers"
            )
        return dict(zip(self._stated.channels, values))
