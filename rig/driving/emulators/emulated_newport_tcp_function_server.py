"""TCP side of an emulated Newport controller: function calls of several callers, each answered in its own connection.

A caller's next call waits until the one before is answered, as at the controller itself.
"""

import re
import select
import socket
from collections import deque
from dataclasses import dataclass, field

from rig.driving.newport_function_call_tcp_port import END, MOST_OF_SOCKET
from rig.driving.protocols.protocol_interface_and_user_line_protocol import NUMBERS
from rig.errors import RigError

CALL = re.compile(rb"\s*(\w+\s*\([^()]*\))")  # which no line's end follows


@dataclass(slots=True)
class _Caller:
    """received : what is no whole call yet; calls : whole ones that wait; is_waiting : for an answer"""

    received: bytes = b""
    calls: deque[bytes] = field(default_factory=deque)
    is_waiting: bool = False


class FunctionServer:
    """See rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp.Wire. address : (host, port), port
    0 for any
    that is free

    Raises RigError where it cannot listen
    """

    def __init__(self, address: tuple[str, int]) -> None:
        try:
            self._listening = socket.create_server(address)
        except OSError as error:
            raise RigError(f"cannot listen at {address[0]}:{address[1]}: {error}") from None
        self._callers: dict[socket.socket, _Caller] = {}
        self._asked: dict[int, socket.socket] = {}  # by the number of a call under way
        self._number = 0
        host, port = self._listening.getsockname()[:2]
        self.name = f"xps://{host}:{port}"

    def plug(self) -> None:
        """The address stays."""

    def wait(self, seconds: float) -> bytes:
        if not (lines := self._lines()):
            for ready in select.select([self._listening, *self._callers], [], [], max(seconds, 0))[0]:
                if ready is self._listening:
                    caller = ready.accept()[0]
                    caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._callers[caller] = _Caller()
                else:
                    self._receive(ready)
            lines = self._lines()
        return lines

    def send(self, data: bytes) -> None:
        for line in data.decode("latin-1").splitlines():
            number, _, answer = line.partition(" ")
            caller = self._asked.pop(int(number), None) if number.isdecimal() else None
            if caller in self._callers and answer.endswith(END):
                self._callers[caller].is_waiting = False
                try:
                    caller.sendall(answer.encode("latin-1"))
                except OSError:
                    self._drop(caller)

    def cut(self) -> None:
        for caller in list(self._callers):
            self._drop(caller)

    def close(self) -> None:
        self.cut()
        self._listening.close()

    def _receive(self, caller: socket.socket) -> None:
        try:
            data = caller.recv(MOST_OF_SOCKET)
        except OSError:
            data = b""
        if not data:
            self._drop(caller)
            return
        state = self._callers[caller]
        state.received += data
        while found := CALL.match(state.received):
            state.calls.append(found[1])
            state.received = state.received[found.end() :]

    def _lines(self) -> bytes:
        """Numbered lines of the calls whose turn it is."""
        lines = b""
        for caller, state in self._callers.items():
            if state.calls and not state.is_waiting:
                self._number = self._number % (NUMBERS - 1) + 1
                self._asked[self._number], state.is_waiting = caller, True
                lines += b"%d %s\n" % (self._number, state.calls.popleft())
        return lines

    def _drop(self, caller: socket.socket) -> None:
        del self._callers[caller]
        caller.close()
