"""Ports of controllers (serial, EPICS channel access), and numbered frames with checksum.

A serial port is opened for one process alone, and imports nothing that takes time. Over channel access, EPICS records
are read and written by requests of one line:

    >17 GET RIG:m1.RBV RIG:m1.DMOV*94A1       read them all            <17 OK 12.5 1.0*8E0B
    >18 PUT RIG:m1.VELO=2.5*41D7              write, then read back    <18 OK 2.5*3D52

An answer of ERR and the reason stands for any of them that failed; then none is written, but for STOP, which is written
to every record that is there, as soon as it is found. Texts are percent-encoded. A write asks for no callback: a motor
record would call back at the end of its move. What is read after it on the same circuit is read after it by the server
too. No search by broadcast: the IOC, or its gateway, is named by its address.
"""

import binascii
import io
import os
import re
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple
from urllib.parse import quote

import serial

from rig.driving import newport_function_call_tcp_port, universal_robots_real_time_interface_port
from rig.driving.driving_clock import Clock
from rig.driving.newport_function_call_tcp_port import NewportPort
from rig.driving.tcp_socket_opening_by_url import connect_tcp_socket
from rig.driving.universal_robots_real_time_interface_port import UniversalRobotsPort
from rig.errors import LinkLost, MissingLibrary
from rig.model.protocol_port_and_user_program_name_checks import port_problem

WRITE_TIME = 2.0  # s that a write may take
MOST_SERIAL = 4096  # bytes of a read
SLICE = 1e-3  # s between looks at a port that cannot be waited on
PSEUDO_TERMINALS = range(136, 144)  # majors, /dev/pts/*


def _reason(error: Exception) -> str:
    """Why a port cannot be opened, without pyserial's repetition of its name."""
    number = getattr(error, "errno", None)
    return str(error) if number is None else os.strerror(number)


def _present_ports(url: str) -> str:
    """What ports there are, for somebody who named another device."""
    from serial.tools import list_ports

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
            self._serial = serial.serial_for_url(url, baudrate=baudrate, timeout=0, write_timeout=WRITE_TIME, **alone)
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkLost(f"cannot open {url}: {_reason(error)}{_present_ports(url)}") from None
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
            while not (data := self._serial.read(MOST_SERIAL)):
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
    from serial.tools import list_ports

    ports = [
        port
        for port in list_ports.comports()
        if port.serial_number == usb_id or usb_id.lower() in (port.hwid or "").lower()
    ]
    if len(ports) != 1:
        raise LinkLost(f"{len(ports)} ports answer to usb = {usb_id!r}" + "".join(f"; {port.device}" for port in ports))
    return ports[0].device


_FRAME = re.compile(r"([<>])(-|\d{1,5}) ([^*<>!]*)\*([0-9A-F]{4})")


class Frame(NamedTuple):
    """number : of the request, None where a broken frame is complained of; text : without number and checksum."""

    number: int | None
    text: str


def encode_numbered_frame(direction: str, number: int | None, text: str) -> bytes:
    """Encode a numbered text as a frame. direction : ">" to the controller, "<" from it."""
    body = f"{'-' if number is None else number} {text}"
    return f"{direction}{body}*{_checksum(body)}\n".encode("ascii")


def last_valid_frame_in_line(direction: str, line: str) -> Frame | None:
    """Decode the last valid frame in a line, None where there is none."""
    for match in reversed(list(_FRAME.finditer(line))):
        if match[1] == direction and match[4] == _checksum(f"{match[2]} {match[3]}"):
            return Frame(None if match[2] == "-" else int(match[2]), match[3])
    return None


def _checksum(body: str) -> str:
    """CRC-16/CCITT-FALSE of a frame's body, four hexadecimal digits."""
    return f"{binascii.crc_hqx(body.encode('latin-1'), 0xFFFF):04X}"


SCHEME = "ca"
PATIENCE = 2.0  # s to connect; in which the server answers
MOST_OF_SOCKET = 65536  # bytes of a read
TEXTS = ("EGU", "RTYP", "VERS", "DESC", "DTYP")  # fields that are read as texts


class ChannelAccessPort:
    """See rig.driving.request_and_answer_exchange_with_controller.Port. url : ca://HOST or ca://HOST:PORT

    Raises LinkLost where nothing listens, MissingLibrary without the package caproto
    """

    def __init__(self, url: str, clock: Clock) -> None:
        import getpass

        try:
            import caproto
        except ImportError:
            raise MissingLibrary("EPICS needs the package caproto: pip install 'rig[epics]'") from None
        self._ca: Any = caproto
        self._url, self._clock = url, clock
        self._socket = connect_tcp_socket(url, PATIENCE)
        self._circuit = caproto.VirtualCircuit(our_role=caproto.CLIENT, address=self._socket.getpeername(), priority=0)
        self._channels: dict[str, Any] = {}
        self._replies: dict[int, Any] = {}  # by ioid
        self._writable: dict[int, bool] = {}  # by the client's number of the channel
        # (number, ioids of reads, of writes) of requests without an answer
        self._waiting: deque[tuple[int, list[int], list[int]]] = deque()
        self._in, self._out, self._lock = b"", b"", threading.RLock()
        self._send(
            caproto.VersionRequest(priority=0, version=13),
            caproto.HostNameRequest(socket.gethostname()),
            caproto.ClientNameRequest(getpass.getuser()),
        )

    def write(self, data: bytes) -> None:
        """Send what lines ask for; only for records that were not used before their server is waited for."""
        with self._lock:
            *lines, self._in = (self._in + data).split(b"\n")
            for line in lines:
                frame = last_valid_frame_in_line(">", line.decode("latin-1"))
                if frame is not None and frame.number is not None:
                    self._ask(frame.number, frame.text.split())

    def read(self, until: float) -> bytes:
        while not self._out:
            left = until - self._clock.now()
            if not select.select([self._socket], [], [], max(left, 0.0))[0]:
                break
            with self._lock:
                self._receive()
                self._answer()
        with self._lock:
            out, self._out = self._out, b""
        return out

    def close(self) -> None:
        self._socket.close()

    def _ask(self, number: int, words: list[str]) -> None:
        verb, *rest = words
        names = [word.rpartition("=")[0] if verb == "PUT" else word for word in rest]
        values = {name: word.rpartition("=")[2] for name, word in zip(names, rest)}
        is_stop = verb == "PUT" and all(name.endswith(".STOP") for name in names)
        refused = self._connect(names, (lambda name: self._send(self._put(name, values[name]))) if is_stop else None)
        if verb == "PUT":
            refused += [f"no write access to {name}: see the IOC's access security" for name in self._locked(names)]
        if refused:
            self._out += encode_numbered_frame("<", number, f"ERR {quote('; '.join(refused))}")
            return
        writes: list[Any] = [self._put(name, values[name]) for name in names if verb == "PUT" and not is_stop]
        kinds = self._ca.ChannelType
        reads = [
            self._channels[name].read(data_type=kinds.STRING if _is_text(name) else kinds.DOUBLE) for name in names
        ]
        self._waiting.append((number, [request.ioid for request in reads], [request.ioid for request in writes]))
        self._send(*writes, *reads)

    def _locked(self, names: list[str]) -> list[str]:
        """Those of some names whose channels are there and may not be written."""
        return [
            name for name in names if name in self._channels and not self._writable.get(self._channels[name].cid, True)
        ]

    def _put(self, name: str, value: str) -> object:
        """Request to write a value, which asks for no callback."""
        return self._channels[name].write((float(value),), data_type=self._ca.ChannelType.DOUBLE, notify=False)

    def _answer(self) -> None:
        """Make lines of the requests whose values have all come, in the order of the requests."""
        while self._waiting and all(ioid in self._replies for ioid in self._waiting[0][1]):
            number, ioids, written = self._waiting.popleft()
            replies = [self._replies.pop(ioid) for ioid in ioids]
            errors = [self._replies.pop(ioid) for ioid in written if ioid in self._replies]
            failed = [reply for reply in (*errors, *replies) if isinstance(reply, self._ca.ErrorResponse)]
            if failed:
                text = failed[0].error_message.decode("utf-8", "replace").strip("\0")
                self._out += encode_numbered_frame("<", number, f"ERR {quote(text)}")
            else:
                words = " ".join(_shown(reply.data[0]) for reply in replies)
                self._out += encode_numbered_frame("<", number, f"OK {words}")

    def _connect(self, names: list[str], connected: Callable[[str], None] | None) -> list[str]:
        """Make channels of names where they are not yet. Returns why there is none, a line for each without one.

        connected : takes each name as soon as its channel is there, before the others are waited for
        """
        fresh = [name for name in dict.fromkeys(names) if name not in self._channels]
        for name in fresh:
            self._channels[name] = self._ca.ClientChannel(name, self._circuit)
        if fresh:
            self._send(*(self._channels[name].create() for name in fresh))
        refused, left, end = [], list(dict.fromkeys(names)), self._clock.now() + PATIENCE
        while left:
            for name in tuple(left):
                state = self._channels[name].states[self._ca.CLIENT]
                if state is self._ca.FAILED:
                    del self._channels[name]
                    refused.append(f"the server has no {name}")
                elif state is not self._ca.CONNECTED:
                    continue
                elif connected is not None:
                    connected(name)
                left.remove(name)
            patience = max(end - self._clock.now(), 0.0)
            if left and not select.select([self._socket], [], [], patience)[0]:
                return refused + [f"no channel {name} within {PATIENCE:g} s" for name in left]
            if left:
                self._receive()
        return refused

    def _send(self, *commands: object) -> None:
        try:
            self._socket.sendall(b"".join(bytes(part) for part in self._circuit.send(*commands)))
        except OSError as error:
            raise LinkLost(f"{self._url}: connection lost: {error.strerror or error}") from None

    def _receive(self) -> None:
        try:
            data = self._socket.recv(MOST_OF_SOCKET)
            if hasattr(socket, "TCP_QUICKACK"):  # a server that waits for acknowledgements would answer 40 ms late
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except OSError as error:
            raise LinkLost(f"{self._url}: connection lost: {error.strerror or error}") from None
        if not data:
            raise LinkLost(f"{self._url}: the server has closed the connection")
        commands, _ = self._circuit.recv(data)
        for command in commands:
            self._circuit.process_command(command)
            if isinstance(command, self._ca.ServerDisconnResponse):
                raise LinkLost(f"{self._url}: the server has taken a record away")
            if isinstance(command, self._ca.AccessRightsResponse):
                self._writable[command.cid] = bool(command.access_rights & self._ca.AccessRights.WRITE)
            elif isinstance(command, self._ca.ReadNotifyResponse):
                self._replies[command.ioid] = command
            elif isinstance(command, self._ca.ErrorResponse):
                request = command.original_request
                if getattr(request, "ioid", None) is not None:
                    self._replies[request.ioid] = command


def _is_text(name: str) -> bool:
    return name.rpartition(".")[2] in TEXTS


def _shown(value: object) -> str:
    if isinstance(value, bytes):
        return quote(value.split(b"\0")[0].decode("utf-8", "replace")) or "-"
    return repr(float(str(value)))


def open_controller_port(
    port: str, usb: str, baudrate: int, clock: Clock
) -> SerialPort | ChannelAccessPort | NewportPort | UniversalRobotsPort:
    """The open port of a controller. port, usb, baudrate : as [controller] states them

    Raises LinkLost where it does not open, MissingLibrary for an IOC without the package that it takes
    """
    scheme = port.partition("://")[0].lower()
    if scheme == SCHEME:
        return ChannelAccessPort(port, clock)
    if scheme == newport_function_call_tcp_port.SCHEME:
        return NewportPort(port, clock)
    if scheme == universal_robots_real_time_interface_port.SCHEME:
        return UniversalRobotsPort(port, clock)
    return SerialPort(find_usb_port(port, usb), baudrate, clock)
