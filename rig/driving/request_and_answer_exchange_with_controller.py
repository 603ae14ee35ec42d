"""Exchange of requests and answers with a controller.

Over a port: one at a time, with timeout and reconnection.

Every byte sent and received can be traced.
"""

import re
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol as Interface
from typing import TextIO, TypeVar

from rig.driving.driving_clock import Clock
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Dialogue, Exchange, Lines, Protocol
from rig.errors import LinkLost, NoAnswer, Stopped

T = TypeVar("T")
LONGEST = 4096  # bytes of a line; what is longer is no line
LINE_ENDS = re.compile(rb"[\r\n\x03]")  # Klipper ends its messages by the last one
SLICE = 0.05  # s between looks at whether somebody wants to stop
BACKOFF = (0.05, 2.0)  # s before the second try to connect, and at most
EVENTS = 100


class Port(Interface):
    """What carries bytes. Everything raises LinkLost when the connection is gone."""

    def write(self, data: bytes) -> None:
        """Send bytes, all of them, in bounded time."""

    def read(self, until: float) -> bytes:
        """What has come; where nothing has, what comes until then (s on the clock), b"" for nothing."""

    def close(self) -> None:
        """Close the port; may be called twice."""


def bytes_as_text(sent: Sequence[bytes]) -> str:
    """Sent bytes as text for a message.

    Each write as a Python text, without the end of its line.
    """
    return ", ".join(repr(data.decode("latin-1").strip("\r\n")) for data in sent)


class Link:
    """A controller at the other end of a port.

    protocol : speaks for it; opener : makes a Port anew each time; clock : Clock; timeout : s, for an answer
    trace : takes a line per write and read, with the time, or None
    events : (t, text) of what the controller said unasked; sent : the requests of the last dialogue
    """

    def __init__(
        self,
        protocol: Protocol,
        opener: Callable[[], Port],
        clock: Clock,
        timeout: float = 1.0,
        trace: TextIO | None = None,
    ) -> None:
        self.protocol, self.clock, self.timeout = protocol, clock, timeout
        self.events: deque[tuple[float, str]] = deque(maxlen=EVENTS)
        self.sent: list[bytes] = []
        self._opener, self._trace = opener, trace
        self._port: Port | None = None
        self._rest = b""
        self._lock, self._writing = threading.RLock(), threading.Lock()
        self._stop = threading.Event()

    def greeting(self) -> str:
        """What a controller says that it is, as nothing was heard from it yet. Raises NoAnswer with what may be stated
        wrongly.
        """
        try:
            return self.run(self.protocol.hello())
        except NoAnswer as error:
            raise NoAnswer(
                f"{error}: is the controller switched on and at this port, and are protocol and baudrate in "
                "[controller] "
                "its own?"
            ) from None

    def connect(self, patience: float) -> None:
        """Open the port, trying again with growing pauses for so long (s). Raises LinkLost with the last reason."""
        pause, end = BACKOFF[0], self.clock.now() + patience
        self.close()
        while True:
            try:
                self._port, self._rest = self._opener(), b""
                return
            except LinkLost:
                if self.clock.now() + pause > end:
                    raise
            self.clock.sleep(pause)
            pause = min(2 * pause, BACKOFF[1])

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
        self._port = None

    def run(self, dialogue: Dialogue[T], stoppable: bool = True) -> T:
        """What a dialogue comes to. Raises what it raises, LinkLost, and Stopped where somebody called `interrupt`
        (unless not stoppable).
        """
        with self._lock:
            self.sent = []
            try:
                exchange = next(dialogue)
                while True:
                    exchange = dialogue.send(self._exchange(exchange, stoppable))
            except StopIteration as end:
                return end.value

    def interrupt(self) -> None:
        """From any thread: send the bytes that slow every axis down, past a request in flight, and end that with
        Stopped.
        """
        self._stop.set()
        if self._port is not None:
            self._write(self.protocol.urgent_stop)

    def resume(self) -> None:
        """Take requests again after `interrupt`."""
        self._stop.clear()

    def _exchange(self, exchange: Exchange, stoppable: bool) -> Lines:
        self._read(self.clock.now())  # what came unasked is not the answer
        self._rest = b""
        if stoppable and self._stop.is_set():  # nothing follows an urgent stop
            raise Stopped("stopped on request")
        if exchange.data:
            self.sent.append(exchange.data)
            self._write(exchange.data)
        lines: list[str] = []
        end = self.clock.now() + (self.timeout if exchange.timeout is None else exchange.timeout)
        while True:
            if stoppable and self._stop.is_set():
                raise Stopped("stopped on request")
            now = self.clock.now()
            for line in self._read(min(end, now + SLICE)):
                lines.append(line)
                if exchange.complete(lines):
                    return tuple(lines)
            if self.clock.now() >= end:
                return None

    def _read(self, until: float) -> list[str]:
        """Whole lines that came, without their ends; waits for the first byte until then (s on the clock)."""
        if self._port is None:
            raise LinkLost("not connected")
        data = self._port.read(until)
        if not data:
            return []
        self._traced("<", data)
        *whole, self._rest = re.split(LINE_ENDS, self._rest + data)
        if len(self._rest) > LONGEST:
            self._rest = b""
        lines = [line.decode("latin-1").strip("\x00") for line in whole]
        lines = [line for line in lines if line.strip()]
        for line in lines:
            if event := self.protocol.event(line):
                self.events.append((self.clock.now(), event))
        return lines

    def _write(self, data: bytes) -> None:
        with self._writing:
            if self._port is None:
                raise LinkLost("not connected")
            self._traced(">", data)
            self._port.write(data)

    def _traced(self, sign: str, data: bytes) -> None:
        if self._trace is not None:
            self._trace.write(f"{self.clock.now():.6f} {sign} {data!r}\n")
            self._trace.flush()
