"""Eyes at a TCP port: requests of a line each, answered in the order in which they came; see rig/cameras/emulated.py for the words."""

import json
import selectors
import socket
from collections.abc import Callable

import numpy as np

from rig.clock import Clock
from rig.errors import RigError
from synthetic.eyes import Eyes

LONGEST = 200  # bytes of a request
LOOK = 0.2  # s between looks at whether to go on


class EyesServer:
    """Listens at an address (host, port; 0: any). One picture is drawn at a time, in the thread that calls `serve`: OpenGL wants that."""

    def __init__(self, eyes: Eyes, address: tuple[str, int], clock: Clock) -> None:
        self._eyes, self._clock = eyes, clock
        try:
            self._listening = socket.create_server(address)
        except OSError as error:
            raise RigError(f"cannot listen at {address[0]}:{address[1]}: {error}") from None
        self.name = "{}:{}".format(*self._listening.getsockname()[:2])
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._rests: dict[socket.socket, bytes] = {}

    def serve(self, going: Callable[[], bool]) -> None:
        """Answer while going() says so."""
        while going():
            asked = []
            for key, _ in self._selector.select(LOOK):
                if key.fileobj is self._listening:
                    caller = self._listening.accept()[0]
                    caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._rests[caller] = b""
                    self._selector.register(caller, selectors.EVENT_READ)
                else:
                    asked += [(key.fileobj, line, self._clock.now()) for line in self._lines(key.fileobj)]
            for caller, line, t in asked:  # all were exposed when they asked; drawing takes its time
                self._answer(caller, line, t)

    def close(self) -> None:
        """Hang up on everybody."""
        for caller in list(self._rests):
            self._hang_up(caller)
        self._selector.close()
        self._listening.close()

    def _lines(self, caller: socket.socket) -> list[str]:
        try:
            data = caller.recv(LONGEST)
        except OSError:
            data = b""
        if not data or len(self._rests[caller]) > LONGEST:
            self._hang_up(caller)
            return []
        *lines, self._rests[caller] = (self._rests[caller] + data).split(b"\n")
        return [line.decode("latin-1").strip() for line in lines]

    def _answer(self, caller: socket.socket, line: str, t: float) -> None:
        if caller not in self._rests:
            return
        try:
            data = self._reply(line.split(), t)
        except RigError as error:
            data = json.dumps({"error": str(error)}).encode() + b"\n"
        try:
            caller.sendall(data)
        except OSError:
            self._hang_up(caller)

    def _reply(self, words: list[str], t: float) -> bytes:
        if words == ["sensors"]:
            return (",".join(f"{value:.9g}" for value in self._eyes.sensors(t).values()) + "\n").encode()
        if len(words) != 3 or words[0] != "expose":
            raise RigError(f"expected `expose CAMERA SECONDS` or `sensors`, got {' '.join(words)!r}")
        try:
            exposure = float(words[2])
        except ValueError:
            exposure = np.nan
        if not 0 < exposure < 100:
            raise RigError(f"an exposure of {words[2]} s is none")
        image = self._eyes.image(words[1], t, exposure)
        head = {"width": image.shape[1], "height": image.shape[0], "bits": 8 if image.dtype == np.uint8 else 12, "age": self._clock.now() - t}
        return json.dumps(head).encode() + b"\n" + image.astype(np.uint8 if image.dtype == np.uint8 else "<u2").tobytes()

    def _hang_up(self, caller: socket.socket) -> None:
        if self._rests.pop(caller, None) is not None:
            self._selector.unregister(caller)
            caller.close()
