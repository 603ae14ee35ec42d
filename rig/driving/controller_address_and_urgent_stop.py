"""Controller address, and its urgent stop.

As rig.toml states it; the stop is sent before anything that takes time is imported.

What a rig.toml states of its controller is read here as text alone; whoever goes on reads it whole, and refuses it.
"""

import os
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from rig.driving.controller_lock_and_stop_of_its_holder import (
    ControllerLock,
    ask_lock_holder_to_end,
    await_or_kill_lock_holder,
)
from rig.driving.driving_clock import Clock
from rig.driving.newport_function_call_tcp_port import NewportPort
from rig.driving.serial_and_epics_ports_and_checksummed_frames import (
    ChannelAccessPort,
    SerialPort,
    encode_numbered_frame,
    open_controller_port,
)
from rig.driving.universal_robots_real_time_interface_port import UniversalRobotsPort
from rig.errors import FileError
from rig.model.protocol_port_and_user_program_name_checks import MOTOR_RECORDS

CLIENT = "rig 1.0"  # who greets linuxcncrsh
STOPS = {
    "grblhal": b"!",
    "gcs": b"\x18",
    "gcs-hexapod": b"\x18",
    "hxp": b"0 GroupMoveAbort(HEXAPOD)\n",
    "symetrie": b"c_cmd=C_STOP\n",
    "linuxcnc": b"SET ABORT\r\n",
    "struts": b"!",
    "urscript": b"stopj(3)\n",  # rad/s^2
    **dict.fromkeys(MOTOR_RECORDS, b""),  # which take the names of records, see epics_motor_record_stop_bytes
}


def epics_motor_record_stop_bytes(motors: Iterable[str]) -> bytes:
    """Bytes that stop EPICS motor records.

    As a ChannelAccessPort takes them: all of those that are there.
    What is not there is named when the protocol's own stop follows.
    """
    return encode_numbered_frame(">", 0, f"PUT {' '.join(f'{motor}.STOP=1' for motor in motors)}")


class ControllerAddress(NamedTuple):
    """Where a controller is, and how it is spoken to. port, usb, baudrate, protocol, password, enable_password : as
    [controller] states them; stop : its protocol's bytes that stop it; axes : the controller's names of them, ()
    where they have usual ones
    """

    protocol: str
    port: str
    usb: str
    baudrate: int
    password: str
    enable_password: str
    stop: bytes
    axes: tuple[str, ...] = ()

    def urgent_stop(self) -> bytes:
        """Bytes that stop it though nothing was sent to it before."""
        stop = self.stop
        if self.protocol in MOTOR_RECORDS:
            return epics_motor_record_stop_bytes(self.axes)
        if self.protocol != "linuxcnc":
            return stop
        return f"HELLO {self.password} {CLIENT}\r\nSET ENABLE {self.enable_password}\r\n".encode() + stop


class StoppedController(NamedTuple):
    """A controller that was sent its urgent stop. lock, port : held, open; sent : what; t : when, s on the clock"""

    lock: ControllerLock
    port: SerialPort | ChannelAccessPort | NewportPort | UniversalRobotsPort
    sent: bytes
    t: float


def controller_address_in_rig_toml(path: str | os.PathLike[str], port: str | None) -> ControllerAddress | None:
    """ControllerAddress that a rig.toml states.

    None where it cannot be read as text alone.
    port : in place of the stated one
    """
    try:
        with open(path, encoding="utf-8") as file:
            table = tomllib.loads(file.read()).get("controller")
    except (OSError, ValueError):
        return None
    if not isinstance(table, dict):
        return None
    words = {"port": "", "usb": "", "password": "EMC", "enable_password": "EMCTOO", **table}
    words |= {"port": port, "usb": ""} if port else {}
    baudrate, protocol = table.get("baudrate", 115200), table.get("protocol")
    axes = table.get("axes", [])
    texts = [words[name] for name in ("port", "usb", "password", "enable_password")]
    stop = _stop_bytes(protocol, path) if isinstance(protocol, str) else None
    if stop is None or not all(isinstance(text, str) for text in texts) or type(baudrate) is not int:
        return None
    if not (texts[0] or texts[1]):
        return None
    if not isinstance(axes, list) or not all(isinstance(name, str) for name in axes):
        return None
    return ControllerAddress(str(protocol), texts[0], texts[1], baudrate, texts[2], texts[3], stop, tuple(axes))


def _stop_bytes(protocol: str, path: str | os.PathLike[str]) -> bytes | None:
    """Bytes that stop a controller, None where they cannot be read as text alone. Of a user's file they are a literal
    that is read; the file is not run. path : of rig.toml
    """
    kind, _, place = protocol.partition(":")
    if kind != "file":
        return STOPS.get(protocol)
    from pathlib import Path  # these take time, and other protocols do without

    from rig.formats.user_python_file_reading_and_running import literal_in_class_body, read_user_text_and_sha256

    try:
        stop = literal_in_class_body(read_user_text_and_sha256(Path(path).parent / place)[0], "urgent_stop")
    except FileError:
        return None
    return stop if isinstance(stop, bytes) else None


@contextmanager
def stop_controller_urgently_and_hold_it(address: ControllerAddress, clock: Clock) -> Iterator[StoppedController]:
    """Urgently stopped controller, a StoppedController (context manager).

    Its lock held, its urgent stop sent, its port closed at the end.

    Nobody else drives it meanwhile.

    Raises RigError where another process drives it, LinkLost where its port does not open.
    """
    with ExitStack() as stack:
        lock = ControllerLock(address.port, address.usb)
        stack.push(lock)
        port = open_controller_port(address.port, address.usb, address.baudrate, clock)
        stack.callback(port.close)
        data = address.urgent_stop()
        port.write(data)
        sent = clock.now()
        lock.__enter__()  # its thread takes long to start on a busy computer
        yield StoppedController(lock, port, data, sent)


class UrgentStop:
    """A stop that was begun: the process that drives was asked to end; where none does, the urgent stop was sent.

    A context manager, at whose end the controller's port is closed and its lock released.
    holder : the process that was asked to end, None where none drove; clock : of the times
    """

    def __init__(self, address: ControllerAddress, clock: Clock) -> None:
        """Raises what stop_controller_urgently_and_hold_it raises."""
        self._address, self.clock, self._stack = address, clock, ExitStack()
        self._stopped: StoppedController | None = None
        self.holder = ask_lock_holder_to_end(address.port, address.usb)
        if self.holder is None:
            self.stopped_controller()

    def __enter__(self) -> "UrgentStop":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def await_holder(self, timeout: float) -> None:
        """Return once the holder drives no more; it is killed after `timeout` (s). Raises RigError where that fails."""
        if self.holder is not None:
            await_or_kill_lock_holder(self.holder, self._address.port or self._address.usb, self.clock, timeout)

    def stopped_controller(self) -> StoppedController:
        """The controller, sent its urgent stop once. Raises what stop_controller_urgently_and_hold_it raises."""
        if self._stopped is None:
            self._stopped = self._stack.enter_context(stop_controller_urgently_and_hold_it(self._address, self.clock))
        return self._stopped
