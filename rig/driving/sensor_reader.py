"""Reader of sensors during a run.

From a port, a line of numbers per reading, or by a program of the user's own.
"""

from collections.abc import Callable, Mapping

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.clock import Clock
from rig.driving.request_and_answer_exchange_with_controller import Port
from rig.driving.serial_port import SerialPort
from rig.driving.user_protocol_camera_and_sensor_classes import fail_at_class, guard_call, load_user_class
from rig.errors import NoAnswer, RigError
from rig.formats.number_parsing_and_rounding import parse_numbers
from rig.model.design import SensorPort
from rig.model.protocol_and_port_names import is_user_program

WAIT = 2.0  # s for a line
LONGEST = 4096  # bytes
GROUP = "rig.sensors"  # of entry points


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


class UserSensors:
    """Base class of sensors or an instrument of the user's own. channels : names as [sensors] states them."""

    def __init__(self, channels: tuple[str, ...]) -> None:
        self.channels = channels

    def read(self) -> Mapping[str, float]:
        """{channel: value} measured after this call."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the device."""


class UserSensorReader(SensorReader):
    """Sensors that a class in a user's file or package reads; see SensorReader."""

    def __init__(self, stated: SensorPort) -> None:
        """Raises FileError or RigError where the program cannot be used."""
        kind, path = load_user_class(stated.port, UserSensors, GROUP, "sensors")
        if kind.read is UserSensors.read:
            raise fail_at_class(path, kind, "lacks read, which returns {channel: value}")
        self._stated, self._path, self._owner = stated, path, kind.__name__
        self._user = guard_call(kind, path, RigError, self._owner)(stated.channels)

    def read(self) -> dict[str, float]:
        found = guard_call(self._user.read, self._path, NoAnswer, self._owner)()
        channels = self._stated.channels
        values = {name: float(found[name]) for name in channels if name in found}
        wrong = [name for name in channels if not np.isfinite(values.get(name, np.nan))]
        if wrong:
            raise NoAnswer(f"{self._path}: {self._owner}.read gave no number for {', '.join(wrong)}")
        return values

    def close(self) -> None:
        guard_call(self._user.close, self._path, RigError, self._owner)()


def open_sensors(stated: SensorPort, clock: Clock) -> SensorReader:
    """The sensors of a rig.toml, opened.

    Raises LinkLost for a port, FileError or RigError for a program.
    """
    return UserSensorReader(stated) if is_user_program(stated.port) else SensorReader(stated, clock)
