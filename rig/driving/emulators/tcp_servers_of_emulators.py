"""TCP servers of emulators.

The base, which takes and drops callers, and one of plain bytes.
"""

import select
import socket
from collections.abc import Iterator

from rig.errors import RigError

MOST = 65536  # bytes of a read


class TcpServer:
    """Base of an emulator's TCP side; see
    rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp.Wire.

    address : (host, port), port 0 for any that is free. Raises RigError where it cannot listen
    """

    scheme = "socket"  # of its URL

    def __init__(self, address: tuple[str, int]) -> None:
        try:
            self._listening = socket.create_server(address)
        except OSError as error:
            raise RigError(f"cannot listen at {address[0]}:{address[1]}: {error}") from None
        self._callers: list[socket.socket] = []
        host, port = self._listening.getsockname()[:2]
        self.name = f"{self.scheme}://{host}:{port}"

    def plug(self) -> None:
        """The address stays."""

    def cut(self) -> None:
        for caller in list(self._callers):
            self._drop(caller)

    def close(self) -> None:
        self.cut()
        self._listening.close()

    def _received(self, seconds: float) -> Iterator[tuple[socket.socket, bytes]]:
        """(caller, bytes) of those who sent something within a time (s); takes new callers, drops those who left."""
        for ready in select.select([self._listening, *self._callers], [], [], max(seconds, 0))[0]:
            if ready is self._listening:
                self._take(ready.accept()[0])
                continue
            try:
                data = ready.recv(MOST)
            except OSError:
                data = b""
            if data:
                yield ready, data
            else:
                self._drop(ready)

    def _take(self, caller: socket.socket) -> None:
        caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._callers.append(caller)

    def _drop(self, caller: socket.socket) -> None:
        if caller in self._callers:  # else it was dropped before
            self._callers.remove(caller)
            caller.close()


class ByteServer(TcpServer):
    """A TCP port whose bytes are the line's; a new caller takes it over."""

    def wait(self, seconds: float) -> bytes:
        return b"".join(data for _, data in self._received(seconds))

    def send(self, data: bytes) -> None:
        for caller in list(self._callers):
            try:
                caller.sendall(data)
            except OSError:
                self._drop(caller)

    def _take(self, caller: socket.socket) -> None:
        self.cut()
        super()._take(caller)
