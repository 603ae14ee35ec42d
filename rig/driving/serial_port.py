"""Serial port of a controller, and sensors read from one: a line of numbers per reading."""

import fcntl
import io
import os
import select
import termios
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import serial
from serial.tools import list_ports

from rig.array_and_json_types import Floats
from rig.driving.clock import Clock
from rig.driving.controller_requests_and_answers import Port
from rig.errors import LinkLost, NoAnswer
from rig.formats.number_parsing_and_rounding import parse_numbers
from rig.model.design import SensorPort, port_problem

PATIENCE = 2.0  # s that a write may take
MOST = 4096  # bytes of a read
SLICE = 1e-3  # s between looks at a port that cannot be waited on
PSEUDO_TERMINALS = range(136, 144)  # majors, /dev/pts/*


def _reason(error: Exception) -> str:
    """Why a port cannot be opened, without pyserial's repetition of its name."""
    number = getattr(error, "errno", None)
    return str(error) if number is None else os.strerror(number)


def _there(url: str) -> str:
    """What ports there are, for somebody who named another device."""
    found = sorted(port.device for port in list_ports.comports())
    return "" if "://" in url else f"; serial ports here: {', '.join(found) or 'none'} (`rig doctor` lists them)"


class SerialPort:
    """See rig.driving.controller_requests_and_answers.Port. url : see rig.model.design.port_problem; baudrate : for
    devices; clock : tells until when to wait.

    A device is opened for this process alone: locked as pyserial and others do, and by TIOCEXCL, which no user but root
    passes
    """

    def __init__(self, url: str, baudrate: int, clock: Clock) -> None:
        self._url, self._clock = url, clock
        if problem := port_problem(url):
            raise LinkLost(problem)
        alone: dict[str, Any] = {} if "://" in url else {"exclusive": True}
        try:
            self._serial = serial.serial_for_url(url, baudrate=baudrate, timeout=0, write_timeout=PATIENCE, **alone)
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkLost(f"cannot open {url}: {_reason(error)}{_there(url)}") from None
        try:
            self._waitable: int | None = self._serial.fileno()
        except (io.UnsupportedOperation, AttributeError):  # rfc2217:// and loop:// have none
            self._waitable = None
        self._device = None if "://" in url else self._waitable
        if self._device is not None and _ends_with_us(self._device):
            fcntl.ioctl(self._device, termios.TIOCEXCL)

    def write(self, data: bytes) -> None:
        try:
            self._serial.write(data)
        except (serial.SerialException, OSError) as error:
            raise LinkLost(f"{self._url}: cannot be written to: {error}") from None

    def read(self, until: float) -> bytes:
        try:
            while not (data := self._serial.read(MOST)):
                left = until - self._clock.now()
                if left <= 0:
                    break
                if self._waitable is None:
                    self._clock.sleep(min(left, SLICE))
                else:
                    select.select([self._waitable], [], [], left)
            return data
        except (
            serial.SerialException,
            OSError,
            TypeError,
            ValueError,
        ) as error:  # the last two from a port closed under a read
            raise LinkLost(f"{self._url}: connection lost: {error}") from None

    def close(self) -> None:
        if self._device is not None:
            with suppress(OSError):  # unplugged: nothing is left to unlock
                fcntl.flock(self._device, fcntl.LOCK_UN)  # a forked child may hold the same open file a little longer
                fcntl.ioctl(self._device, termios.TIOCNXCL)
            self._device = None
        self._serial.close()


def _ends_with_us(handle: int) -> bool:
    """Whether TIOCEXCL ends with the process that set it; at a pseudo-terminal it would stay as long as the other end
    is open.
    """
    return os.major(os.fstat(handle).st_rdev) not in PSEUDO_TERMINALS


def find_usb_port(url: str, usb_id: str) -> str:
    """Find the port of a USB device by its id; `url` where no id is stated.
    url : its port when nothing else is known; usb_id : its serial number or a part of its hardware id, "" where none
    is stated. Raises LinkLost where it is not plugged in, or several answer to it. of its hardware id, "" where
    none is stated. Raises LinkLost where it is not plugged in, or several
    answer to it.
    """
    if not usb_id:
        return url
    ports = [
        port
        for port in list_ports.comports()
        if port.serial_number == usb_id or usb_id.lower() in (port.hwid or "").lower()
    ]
    if len(ports) != 1:
        raise LinkLost(f"{len(ports)} ports answer to usb = {usb_id!r}" + "".join(f"; {port.device}" for port in ports))
    return ports[0].device


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
