"""Port of Newport's HXP and XPS controllers: function calls as text over TCP, by requests of one line.

    17 GroupStatusGet(HEXAPOD,int *)          the request, numbered
    17 0,12,EndOfAPI                          its answer: error (0 for none), values

The controller answers a call once it is done, a move at its end, and takes no other on the same connection meanwhile.
So moves, stops and all else have a connection each. Neither calls nor answers have numbers or ends of lines there:
each connection is sent one call at a time, and what it answers is the answer to that.
Source: the text interface of Newport's XPS controllers over TCP, as its public drivers have it.
"""

import select
import threading
from collections import deque

from rig.driving.driving_clock import Clock
from rig.driving.tcp_socket_opening_by_url import connect_tcp_socket
from rig.errors import LinkLost

SCHEME = "xps"
PATIENCE = 2.0  # s to connect
MOST_OF_SOCKET = 65536  # bytes of a read
END = ",EndOfAPI"
BLOCKING = ("HexapodMoveAbsolute", "GroupInitialize", "GroupHomeSearch")  # that are answered at their end
STOPPING = ("GroupMoveAbort", "GroupKill", "KillAll")


class _Connection:
    """A connection that is sent one call at a time. Raises LinkLost where nothing listens."""

    def __init__(self, url: str) -> None:
        self.socket = connect_tcp_socket(url, PATIENCE)
        self._calls: deque[tuple[str, str]] = deque()  # (number, call); the first has been sent
        self._in = ""

    def call(self, number: str, text: str) -> None:
        """Send a call, once those before are answered. Raises OSError."""
        self._calls.append((number, text))
        if len(self._calls) == 1:
            self.socket.sendall(text.encode("ascii"))

    def answers(self) -> str:
        """Lines of the answers that have come; something is there to be read. Raises OSError where it is closed."""
        data = self.socket.recv(MOST_OF_SOCKET)
        if not data:
            raise OSError("the controller has closed the connection")
        self._in += data.decode("latin-1")
        lines = ""
        while END in self._in:
            answer, _, self._in = self._in.partition(END)
            if not self._calls:
                raise OSError(f"{answer!r} came unasked")
            lines += f"{self._calls.popleft()[0]} {' '.join(answer.split())}{END}\n"
            if self._calls:
                self.socket.sendall(self._calls[0][1].encode("ascii"))
        return lines


class NewportPort:
    """See rig.driving.request_and_answer_exchange_with_controller.Port. url : xps://HOST or xps://HOST:PORT

    Raises LinkLost where nothing listens
    """

    def __init__(self, url: str, clock: Clock) -> None:
        self._url, self._clock, self._lock = url, clock, threading.RLock()
        self._connections: list[_Connection] = []
        try:
            for _ in range(3):
                self._connections.append(_Connection(url))
        except LinkLost:
            self.close()
            raise
        self._in, self._out = b"", b""

    def write(self, data: bytes) -> None:
        moves, stops, others = self._connections
        with self._lock:
            *lines, self._in = (self._in + data).split(b"\n")
            for line in lines:
                number, _, call = line.decode("ascii").partition(" ")
                name = call.partition("(")[0]
                connection = moves if name in BLOCKING else stops if name in STOPPING else others
                try:
                    connection.call(number, call)
                except OSError as error:
                    raise LinkLost(f"{self._url}: cannot be written to: {error.strerror or error}") from None

    def read(self, until: float) -> bytes:
        sockets = {one.socket: one for one in self._connections}
        try:
            while not self._out:
                ready = select.select(list(sockets), [], [], max(until - self._clock.now(), 0.0))[0]
                if not ready:
                    break
                with self._lock:
                    for one in ready:
                        self._out += sockets[one].answers().encode("latin-1")
        except (OSError, ValueError) as error:  # the last from a socket closed under a read
            raise LinkLost(f"{self._url}: connection lost: {getattr(error, 'strerror', None) or error}") from None
        with self._lock:
            out, self._out = self._out, b""
        return out

    def close(self) -> None:
        for connection in self._connections:
            connection.socket.close()
