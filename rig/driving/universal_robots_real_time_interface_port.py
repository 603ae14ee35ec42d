"""Port of Universal Robots' real-time interface.

Scripts go in, packets of the robot's state come out, as lines of text.

    17 state                              the request, numbered; the answer is the second packet that comes after it
    17 state 812.4 7 1 1 0.1 .. 0.3       seconds since the controller started, robot mode, safety mode, program state,
                                          actual joint positions in rad
    18 movej([..], a=1.4, v=1.05)         the script alone is sent; a robot answers none
    18 sent
    stopj(3)                              a line without a number is sent as it is

Packets come 125 times a second or more, whether they are asked for or not. The first that comes after a request may
have been made before it.
Source: Universal Robots, realtime client interface (port 30003), RealTime 5.9: time in column 1, q actual in 32 to 37.
The modes follow from its list of fields. ur_modern_driver reads the same up to the safety mode in packets of 3.0 and
later, python-ur-control the robot mode and, in packets of 1140 and 1220 bytes, the program state at 131.
"""

import re
import socket
import struct
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress

from rig.driving.driving_clock import Clock
from rig.driving.tcp_socket_opening_by_url import connect_tcp_socket
from rig.errors import LinkLost

SCHEME = "ur"
PATIENCE = 2.0  # s to connect, and until the robot takes what is sent
MOST_OF_SOCKET = 65536  # bytes of a read
SIZE = struct.Struct(">i")  # of a packet with itself
DOUBLES, LONGEST = 132, 8192  # numbers that are read of a packet, in doubles; bytes of one
TIME, JOINTS, ROBOT_MODE, SAFETY_MODE, PROGRAM_STATE = 0, 31, 94, 101, 131  # places of the numbers, from 0
NEWER = 2  # packets after a request, of which the last was made after it
_NUMBERED = re.compile(rb"(\d+) (.*)")


def packet(time: float, modes: tuple[int, int, int], joints: Sequence[float]) -> bytes:
    """Packet of the real-time interface with a robot's state.

    time : s; modes : robot, safety, program; joints : six, rad. All else in it is 0.
    """
    values = [0.0] * DOUBLES
    values[TIME], values[JOINTS : JOINTS + 6] = time, joints
    values[ROBOT_MODE], values[SAFETY_MODE], values[PROGRAM_STATE] = map(float, modes)
    return SIZE.pack(SIZE.size + 8 * DOUBLES) + struct.pack(f">{DOUBLES}d", *values)


def robot_state_line(time: float, modes: tuple[int, int, int], joints: Sequence[float]) -> str:
    """Line of text with a robot's state.

    As the port gives it.
    """
    return f"state {time:.3f} {modes[0]} {modes[1]} {modes[2]} " + " ".join(f"{value:.9f}" for value in joints)


def _text_of_packet(data: bytes) -> str:
    values = struct.unpack_from(f">{DOUBLES}d", data, SIZE.size)
    modes = (int(values[ROBOT_MODE]), int(values[SAFETY_MODE]), int(values[PROGRAM_STATE]))
    return robot_state_line(values[TIME], modes, values[JOINTS : JOINTS + 6])


class UniversalRobotsPort:
    """See rig.driving.request_and_answer_exchange_with_controller.Port. url : ur://HOST or ur://HOST:PORT

    Raises LinkLost where nothing listens
    """

    def __init__(self, url: str, clock: Clock) -> None:
        self._url, self._clock = url, clock
        self._socket = connect_tcp_socket(url, PATIENCE)
        self._news = threading.Condition()
        self._in, self._out, self._lost, self._count = b"", b"", "", 0
        self._asked: deque[tuple[bytes, int]] = deque()  # (number, count of packets that answers it)
        threading.Thread(target=self._receive, daemon=True).start()  # what nobody reads would be old when it is read

    def write(self, data: bytes) -> None:
        with self._news:
            *lines, self._in = (self._in + data).split(b"\n")
            for line in lines:
                found = _NUMBERED.fullmatch(line)
                if found is not None and found[2] == b"state":
                    self._asked.append((found[1], self._count + NEWER))
                    continue
                try:
                    self._socket.sendall((line if found is None else found[2]) + b"\n")
                except OSError as error:
                    raise LinkLost(f"{self._url}: cannot be written to: {error.strerror or error}") from None
                if found is not None:
                    self._out += found[1] + b" sent\n"

    def read(self, until: float) -> bytes:
        with self._news:
            while not self._out:
                if self._lost:
                    raise LinkLost(f"{self._url}: connection lost: {self._lost}")
                left = until - self._clock.now()
                if left <= 0 or not self._news.wait(left):
                    break
            out, self._out = self._out, b""
            return out

    def close(self) -> None:
        with self._news:
            self._lost = self._lost or "it was closed"
        with suppress(OSError):  # where the robot has closed it
            self._socket.shutdown(socket.SHUT_RDWR)  # ends the wait for a packet
        self._socket.close()

    def _receive(self) -> None:
        """Take packets until the connection ends; answer what waits for one."""
        rest = b""
        while True:
            try:
                data, reason = self._socket.recv(MOST_OF_SOCKET), "the robot has closed it"
            except TimeoutError:
                continue  # who reads says how long a packet is waited for
            except OSError as error:
                data, reason = b"", error.strerror or str(error)
            rest += data
            while data and len(rest) >= SIZE.size and len(rest) >= (size := SIZE.unpack_from(rest)[0]):
                if not SIZE.size + 8 * DOUBLES <= size <= LONGEST:
                    data = b""
                    reason = f"a packet of {size} bytes is none of the real-time interface of controllers 3.2 and later"
                    break
                self._take(rest[:size])
                rest = rest[size:]
            if not data:
                with self._news:
                    self._lost = self._lost or reason
                    self._news.notify_all()
                return

    def _take(self, data: bytes) -> None:
        with self._news:
            self._count += 1
            while self._asked and self._asked[0][1] <= self._count:
                self._out += b"%s %s\n" % (self._asked.popleft()[0], _text_of_packet(data).encode("ascii"))
            if self._out:
                self._news.notify_all()
