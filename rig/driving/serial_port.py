"""Serial port of a controller.

It is opened for one process alone, and imports nothing that takes time.
"""

import io
import os
import select
from contextlib import suppress
from typing import Any

import serial
from serial.tools import list_ports

from rig.driving.clock import Clock
from rig.errors import LinkLost
from rig.model.protocol_and_port_names import port_problem

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
    """A Port (see request_and_answer_exchange_with_controller). url : as port_problem accepts it; baudrate : for
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
            import fcntl  # on Windows a port has no descriptor, and the system itself opens it for one process alone
            import termios

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
            import fcntl
            import termios

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
    """Find the port of a USB device by its id.

    `url` where no id is stated.
    url : its port when nothing else is known; usb_id : its serial number or a part of its hardware id, "" where none
    is stated. Raises LinkLost where it is not plugged in, or several answer to it.
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
