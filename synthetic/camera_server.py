"""Eyes at a TCP port: requests of a line each, answered in the order in which they came; see
rig/driving/cameras/emulated_camera.py for the words.
"""

import json
import queue
import socket
import threading
from collections.abc import Callable

import numpy as np

from rig.driving.clock import Clock
from rig.errors import RigError
from synthetic.emulated_sensors import Eyes

LONGEST = 200  # bytes of a request
LOOK = 0.2  # s between looks at whether to go on


class EyesServer:
    """Listens at an address (host, port; 0: any). Requests are taken, and the exposure's moment with them, while a
    picture is being drawn; pictures are drawn one after the other in the thread that calls `serve`: OpenGL wants
    that."""

    def __init__(self, eyes: Eyes, address: tuple[str, int], clock: Clock) -> None:
        self._eyes, self._clock = eyes, clock
        try:
            self._listening = socket.create_server(address)
        except OSError as error:
            raise RigError(f"cannot listen at {address[0]}:{address[1]}: {error}") from None
        self.name = "{}:{}".format(*self._listening.getsockname()[:2])
        self._asked: queue.Queue[tuple[socket.socket, str, float]] = queue.Queue()
        threading.Thread(target=self._accept, daemon=True).start()

    def serve(self, going: Callable[[], bool]) -> None:
        """Answer while going() says so."""
        while going():
            try:
                caller, line, t = self._asked.get(timeout=LOOK)
            except queue.Empty:
                continue
            try:
                data = self._reply(line.split(), t)
            except RigError as error:
                data = json.dumps({"error": str(error)}).encode() + b"\n"
            try:
                caller.sendall(data)
            except OSError:
                caller.close()  # who asked is gone

    def close(self) -> None:
        """Listen no longer."""
        self._listening.close()

    def _accept(self) -> None:
        while True:
            try:
                caller = self._listening.accept()[0]
            except OSError:
                return  # closed
            caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._listen, args=(caller,), daemon=True).start()

    def _listen(self, caller: socket.socket) -> None:
        """Take a caller's requests as they come, until he hangs up or sends what is none."""
        with caller, caller.makefile("rb") as stream:
            try:
                while (line := stream.readline(LONGEST)).endswith(b"\n"):
                    self._asked.put((caller, line.decode("latin-1"), self._clock.now()))
            except OSError:
                return  # the line broke; there is nobody to answer

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
        eight = image.dtype == np.uint8
        head = {
            "width": image.shape[1],
            "height": image.shape[0],
            "bits": 8 if eight else 12,
            "age": self._clock.now() - t,
        }
        return json.dumps(head).encode() + b"\n" + image.astype("u1" if eight else "<u2").tobytes()
