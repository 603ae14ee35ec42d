"""Urgent stop: the bytes that stop a controller are sent before anything that takes time is imported.

What a rig.toml states of its controller is read here as text alone; whoever goes on reads it whole, and refuses it.
"""

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rig.driving.clock import Clock
from rig.driving.controller_lock import ControllerLock
from rig.driving.serial_port import SerialPort, find_usb_port
from rig.errors import RigError
from rig.model.controller_protocol_list_and_port_name_check import PROTOCOLS

if TYPE_CHECKING:
    from rig.model.design import Controller

CLIENT = "rig 1.0"  # who greets linuxcncrsh
STOPS = {"grblhal": b"!", "gcs": b"\x18", "linuxcnc": b"SET ABORT\r\n", "struts": b"!"}


@dataclass(frozen=True, slots=True)
class ControllerAddress:
    """Where a controller is, and how it is spoken to. port, usb, baudrate, protocol, password, enable_password : as
    [controller] states them
    """

    protocol: str
    port: str
    usb: str
    baudrate: int
    password: str
    enable_password: str

    def urgent_stop(self) -> bytes:
        """Bytes that stop it though nothing was sent to it before."""
        stop = STOPS[self.protocol]
        if self.protocol != "linuxcnc":
            return stop
        return f"HELLO {self.password} {CLIENT}\r\nSET ENABLE {self.enable_password}\r\n".encode() + stop


@dataclass(frozen=True, slots=True)
class StoppedController:
    """A controller that was sent its urgent stop. lock, port : held, open; sent : what; t : when, s on the clock"""

    lock: ControllerLock
    port: SerialPort
    sent: bytes
    t: float


def controller_address_in_rig_toml(path: Path, port: str | None) -> ControllerAddress | None:
    """ControllerAddress that a rig.toml states, None where it cannot be read as text alone.

    port : in place of the stated one
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get("controller")
    except (OSError, ValueError):
        return None
    if not isinstance(table, dict):
        return None
    words = {"port": "", "usb": "", "password": "EMC", "enable_password": "EMCTOO", **table}
    words |= {"port": port, "usb": ""} if port else {}
    baudrate, protocol = table.get("baudrate", 115200), table.get("protocol")
    texts = [words[name] for name in ("port", "usb", "password", "enable_password")]
    if protocol not in PROTOCOLS or not all(isinstance(text, str) for text in texts) or type(baudrate) is not int:
        return None
    if not (texts[0] or texts[1]):
        return None
    return ControllerAddress(protocol, texts[0], texts[1], baudrate, texts[2], texts[3])


def address_of_controller(controller: "Controller") -> ControllerAddress:
    """Address of the Controller of a design, for a rig.toml that is no local file. Raises RigError for no port."""
    c = controller
    if not (c.port or c.usb):
        raise RigError("[controller] names no port")
    return ControllerAddress(c.protocol, c.port, c.usb, c.baudrate, c.password, c.enable_password)


@contextmanager
def urgently_stopped_controller(address: ControllerAddress, clock: Clock) -> Iterator[StoppedController]:
    """Context manager of a StoppedController: its lock held, its urgent stop sent, its port closed at the end.

    Nobody else drives it meanwhile.

    Raises RigError where another process drives it, LinkLost where its port does not open.
    """
    with ControllerLock(address.port, address.usb) as lock:
        port = SerialPort(find_usb_port(address.port, address.usb), address.baudrate, clock)
        try:
            data = address.urgent_stop()
            port.write(data)
            yield StoppedController(lock, port, data, clock.now())
        finally:
            port.close()
