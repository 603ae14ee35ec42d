"""TCP server of function calls of an emulated Newport controller.

It has several callers, each answered in its own connection.
A caller's next call waits until the one before is answered, as at the controller itself.
"""

import re
import socket
from collections import deque
from dataclasses import dataclass, field

from rig.driving.emulators.tcp_servers_of_emulators import TcpServer
from rig.driving.newport_function_call_tcp_port import END, SCHEME
from rig.driving.protocols.protocol_interface_and_user_line_protocol import NUMBERS

CALL = re.compile(rb"\s*(\w+\s*\([^()]*\))")  # which no line's end follows


@dataclass(slots=True)
class _Caller:
    """received : what is no whole call yet; calls : whole ones that wait; is_waiting : for an answer"""

    received: bytes = b""
    calls: deque[bytes] = field(default_factory=deque)
    is_waiting: bool = False


class FunctionServer(TcpServer):
    """See TcpServer."""

    scheme = SCHEME

    def __init__(self, address: tuple[str, int]) -> None:
        super().__init__(address)
        self._states: dict[socket.socket, _Caller] = {}
        self._asked: dict[int, socket.socket] = {}  # by the number of a call under way
        self._number = 0

    def wait(self, seconds: float) -> bytes:
        if not (lines := self._lines()):
            for caller, data in self._received(seconds):
                state = self._states[caller]
                state.received += data
                while found := CALL.match(state.received):
                    state.calls.append(found[1])
                    state.received = state.received[found.end() :]
            lines = self._lines()
        return lines

    def send(self, data: bytes) -> None:
        for line in data.decode("latin-1").splitlines():
            number, _, answer = line.partition(" ")
            caller = self._asked.pop(int(number), None) if number.isdecimal() else None
            if caller in self._states and answer.endswith(END):
                self._states[caller].is_waiting = False
                try:
                    caller.sendall(answer.encode("latin-1"))
                except OSError:
                    self._drop(caller)

    def _lines(self) -> bytes:
        """Numbered lines of the calls whose turn it is."""
        lines = b""
        for caller, state in self._states.items():
            if state.calls and not state.is_waiting:
                self._number = self._number % (NUMBERS - 1) + 1
                self._asked[self._number], state.is_waiting = caller, True
                lines += b"%d %s\n" % (self._number, state.calls.popleft())
        return lines

    def _take(self, caller: socket.socket) -> None:
        super()._take(caller)
        self._states[caller] = _Caller()

    def _drop(self, caller: socket.socket) -> None:
        super()._drop(caller)
        self._states.pop(caller, None)
