"""HTTP server of the page of one run.

On the loopback: page, live events, camera images, a stop button.

Who asks must come from this computer, name it as the host, come from no other site, and know the token; every path is
one of a fixed few. See docs/operating.md for what that guards against.
"""

import hmac
import json
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from urllib.parse import parse_qs, urlsplit

from rig.array_and_json_types import Json
from rig.errors import RigError

HOST = "127.0.0.1"
FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/view3d.js": ("view3d.js", "text/javascript; charset=utf-8"),
    "/theme.css": ("theme.css", "text/css; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' "
    "data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
}
ALIVE = 0.5  # s between signs of life on a line without events; the page takes SILENT in page.js for death
LAST = 1.0  # s that browsers have to take the last event
LINES = 16  # browsers that may listen at a time
STRANGERS = 16  # connections at a time of which the token is not known yet; one more closes the oldest of them
MOST_FIELDS = 8  # of a query
KNOWN = 64  # connections at a time whose token was right
HEADERS_WITHIN = 3.0  # s that a connection has to send its first request


class PageServer:
    """Serves a run's page until closed. stop : what the button does; port : 0 for any that is free; answer : takes what
    an operator entered, and at which frame, and returns whether that was asked. url : with the token.
    """

    def __init__(
        self, stop: Callable[[], None], port: int = 0, answer: Callable[[str, int], bool] = lambda text, frame: False
    ) -> None:
        self.token = secrets.token_urlsafe(24)
        self._stop, self.answer = stop, answer
        self._draw: Callable[[], Json] = dict
        self._images: dict[str, Callable[[], bytes]] = {}
        self._changed, self._number, self._open, self._lines = threading.Condition(), 0, True, 0
        self._drawing, self._drawn = (
            threading.Lock(),
            (-1, b""),
        )  # number of the event that was drawn last, and what it came to
        try:
            self._server = _Server((HOST, port), _Handler)
        except OSError as error:
            raise RigError(f"the page cannot listen at {HOST}:{port}: {error.strerror}") from None
        self._server.page = self
        self.port = self._server.server_address[1]
        self.url = f"http://{HOST}:{self.port}/?token={self.token}"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        self._thread.start()

    def show(self, event: Callable[[], Json], images: dict[str, Callable[[], bytes]] | None = None) -> None:
        """Notify every browser. Both are called only if one looks, once for all of them, and from any thread.

        event : makes what JSON can hold; images : {camera: makes its JPEG} in place of those before, or None
        """
        with self._changed:
            self._draw = event
            if images is not None:
                self._images = {camera: cache(made) for camera, made in images.items()}
            self._number += 1
            self._changed.notify_all()

    def close(self) -> None:
        """End; browsers are told that the run is over by the last event."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._lines, LAST)
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def pressed(self) -> None:
        """The button was pressed."""
        self._stop()

    def image(self, camera: str) -> bytes | None:
        """The latest JPEG of a camera, None where there is none."""
        with self._changed:
            made = self._images.get(camera)
        return None if made is None else made()

    def listen(self, after: int, seconds: float) -> tuple[int, bytes, bool] | None:
        """(number, event, whether more may come) newer than number `after`, waited for so long (s); None where none
        came.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._number > after or not self._open, seconds)
            if self._number == after and self._open:
                return None
            number, draw, going = self._number, self._draw, self._open
        with self._drawing:
            if self._drawn[0] < number:
                self._drawn = number, json.dumps(draw(), allow_nan=False).encode()
            return *self._drawn, going

    def take_line(self, more: int) -> bool:
        """Count a browser that listens (+1) or no longer does (-1); False where there are too many."""
        with self._changed:
            if more > 0 and self._lines >= LINES:
                return False
            self._lines += more
            self._changed.notify_all()
            return True


Request = socket.socket | tuple[bytes, socket.socket]  # as socketserver has it; the second of other protocols


class _Server(ThreadingHTTPServer):
    """Connections are counted from their first byte, as each takes a file and a thread of the run's own process.

    strangers : {connection: s on the monotonic clock when it came}, the oldest first; known : connections whose token
        was right
    """

    daemon_threads = True
    request_queue_size = 64
    page: PageServer

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self.counting, self.strangers, self.known = threading.Lock(), dict[socket.socket, float](), set[socket.socket]()
        super().__init__(address, handler)

    def process_request(self, request: Request, client_address: object) -> None:
        """Answer a connection in a thread of its own, and close the oldest one without a token where there are too
        many.
        """
        with self.counting:
            if isinstance(request, socket.socket):
                self.strangers[request] = time.monotonic()
            oldest = next(iter(self.strangers)) if len(self.strangers) > STRANGERS else None
            if oldest is not None:
                self._part(oldest)
        super().process_request(request, client_address)

    def service_actions(self) -> None:
        """Close connections that sent no request in time."""
        with self.counting:
            late = time.monotonic() - HEADERS_WITHIN
            for request in [request for request, came in self.strangers.items() if came < late]:
                self._part(request)

    def admit(self, request: socket.socket) -> bool:
        """Count a connection whose token was right; False where there are too many of them."""
        with self.counting:
            if request not in self.known and len(self.known) >= KNOWN:
                return False
            if self.strangers.pop(request, None) is not None:
                self.known.add(request)
            return True

    def shutdown_request(self, request: Request) -> None:
        """Close a connection, which no longer counts."""
        with self.counting:
            if isinstance(request, socket.socket):
                self.strangers.pop(request, None)
                self.known.discard(request)
        super().shutdown_request(request)

    def _part(self, request: socket.socket) -> None:
        """Have a connection's thread come to its end, which closes it."""
        del self.strangers[request]
        with suppress(OSError):  # it is closed already
            request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Request, client_address: object) -> None:
        """A browser that went away is no error of the run's; a mistake of ours is reported, and costs the page
        alone.
        """
        if not isinstance(sys.exception(), OSError):
            print(f"the run's page: {sys.exception()!r}; the run goes on", file=sys.stderr)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 30.0
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "rig", ""

    def do_GET(self) -> None:
        """The page, its files, its events, its images."""
        requested = self._allowed()
        if requested is None:
            return
        path, query = requested
        if path in FILES:
            name, kind = FILES[path]
            data = resources.files("rig.report.pages").joinpath(name).read_bytes()
            self._reply(
                HTTPStatus.OK, data.replace(b"TOKEN", self.server.page.token.encode()) if path == "/" else data, kind
            )
        elif path == "/events":
            self._events()
        elif path == "/image":
            image = self.server.page.image(query.get("camera", [""])[0])
            if image is None:
                self._refuse(HTTPStatus.NOT_FOUND, "no such image yet")
            else:
                self._reply(HTTPStatus.OK, image, "image/jpeg")
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such page")

    def do_POST(self) -> None:
        """The button. Only a page of this very server may press it."""
        request = self._allowed(post=True)
        if request is None:
            return
        path, query = request
        if path == "/answer":
            frame = query.get("frame", [""])[0]
            if not (frame.isdecimal() and self.server.page.answer(query.get("reading", [""])[0], int(frame))):
                self._refuse(HTTPStatus.CONFLICT, "that is not asked now")
                return
            self._reply(HTTPStatus.OK, b'{"taken": true}', "application/json")
            return
        if path != "/stop":
            self._refuse(HTTPStatus.NOT_FOUND, "no such button")
            return
        self.server.page.pressed()
        self._reply(HTTPStatus.OK, b'{"stopped": true}', "application/json")

    def _allowed(self, post: bool = False) -> tuple[str, dict[str, list[str]]] | None:
        """(path, query) of a request that may be answered; None where it was refused."""
        page, port = self.server.page, self.server.page.port
        here = (f"{HOST}:{port}", f"localhost:{port}")
        try:
            if not (
                self.requestline.isascii() and self.requestline.isprintable()
            ):  # control characters part words, or are dropped from a URL
                raise ValueError("no address")
            url = urlsplit(self.path)
            query = parse_qs(url.query, max_num_fields=MOST_FIELDS)
        except ValueError:  # no URL, or more fields than any of ours has
            self._refuse(HTTPStatus.FORBIDDEN, "that is not a request for this page")
            return None
        origin = self.headers.get("Origin")
        if self.client_address[0] != HOST:
            reason = "only this computer"
        elif self.headers.get("Host") not in here:
            reason = (
                f"another host was requested: this page is http://{HOST}:{port} alone; from another computer forward "
                f"the port under the same number, by ssh -L {port}:{HOST}:{port}"
            )
        elif (post and origin is None) or (
            origin is not None and origin not in tuple(f"http://{name}" for name in here)
        ):
            reason = "another site asks"
        elif self.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            reason = "another site asks"
        elif not hmac.compare_digest(query.get("token", [""])[0].encode(), page.token.encode()):
            reason = "the token is missing or wrong; use the address that `rig run --page` printed"
        elif (
            url.scheme
            or url.netloc
            or self.headers.get("Content-Length", "0") != "0"
            or "Transfer-Encoding" in self.headers
        ):
            reason = "that is not a request for this page"
        elif not self.server.admit(self.connection):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections")
            return None
        else:
            return url.path, query
        self._refuse(HTTPStatus.FORBIDDEN, reason)
        return None

    def _events(self) -> None:
        """Events as they come, the latest first (server-sent events)."""
        page, number = self.server.page, -1
        if not page.take_line(+1):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open")
            return
        try:
            self._head(HTTPStatus.OK, "text/event-stream", None)
            going = True
            while going:
                fresh = page.listen(number, ALIVE)
                if fresh is None:
                    self.wfile.write(b"event: alive\ndata: {}\n\n")
                else:
                    number, event, going = fresh
                    self.wfile.write(b"data: " + event + b"\n\n")
                self.wfile.flush()
            self.wfile.write(b"event: end\ndata: {}\n\n")
        except OSError:
            return  # the browser went away
        finally:
            page.take_line(-1)
            self.close_connection = True

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self.close_connection = True
        self._reply(status, (reason + "\n").encode(), "text/plain; charset=utf-8")

    def _reply(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self._head(status, kind, len(body))
        self.wfile.write(body)

    def _head(self, status: HTTPStatus, kind: str, length: int | None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        if length is None or self.close_connection:
            self.send_header("Connection", "close")
        if length is not None:
            self.send_header("Content-Length", str(length))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, form: str, *arguments: object) -> None:
        """Requests are not logged: addresses carry the token."""
