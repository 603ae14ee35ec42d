"""The page of a run: what may ask is answered, everything else is refused, and a browser shows what the run says."""

import contextlib
import http.client
import json
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import threading
import time
from importlib import resources

import pytest

from rig.report.pages import run_page_server
from rig.report.pages.run_page_server import ALIVE, STRANGERS, PageServer

EVENT = {
    "verdict": {"state": "check", "why": "cameras are not adjusted yet"},
    "activity": "moving",
    "then": "1 frame there, step 4 (12.3 mm)",
    "events": [{"t": 1.5, "text": "to step 3, 20.1 mm"}, {"t": 61.0, "text": "jump: <b>strut 2</b>"}],
    "readings": [{"name": "ambient_temperature_C", "value": 21.25}],
    "pictures": None,
    "phase": "moving to step 3",
    "frame": 2,
    "frames": 9,
    "step": 3,
    "steps": 10,
    "left": 75.0,
    "ended": None,
    "struts": [{"low": 400.0, "high": 500.0, "at": 450.0, "goal": 460.5, "room": 50.0}] * 6,
    "question": {"frame": 2, "text": "frame 2 stands at 0 0 450 mm; press Enter once it is measured"},
    "alarms": [{"kind": "camera", "text": "camera 'cam0' <b>moved</b>"}],
    "history": [
        {"frame": 0, "rms": 0.02, "error": None, "innovation": None},
        {"frame": 1, "rms": 0.03, "error": 12.0, "innovation": 1.1},
    ],
    "seen": {
        "frame": 1,
        "reason": "",
        "delay": 0.21,
        "pose": [1.0, 2.0, 450.0, 0.1, 0.2, 0.3],
        "sigma": [1.5] * 6,
        "error": [3.0] * 6,
        "innovation": 1.1,
        "cameras": [
            {
                "name": "cam0",
                "width": 64,
                "height": 48,
                "read": 3,
                "expected": 4,
                "rms": 0.02,
                "blur": 0.7,
                "quads": [[7, True, 1, 1, 9, 1, 9, 9, 1, 9]],
                "arrows": [[1, 1, 0.01, 0.02]],
            }
        ],
    },
    "rig": {
        "parts": [{"kind": "strut", "name": "1", "points": [[0, 0, 0], [0.1, 0, 0.4]]}],
        "middle": [0, 0, 0.2],
        "size": 1.3,
    },
}


@pytest.fixture
def page():
    pressed = []
    made = PageServer(lambda: pressed.append(True))
    made.presses = pressed
    yield made
    made.close()


def ask(page, path, method="GET", host=None, token=True, headers=()):
    """(status, headers, body) of a request."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    if token:
        path += ("&" if "?" in path else "?") + f"token={page.token}"
    connection.putrequest(method, path, skip_host=True)
    for name, value in [("Host", host or f"127.0.0.1:{page.port}"), *headers]:
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def test_who_has_the_token_sees_the_page_and_nothing_leads_elsewhere(page):
    for path, kind in (
        ("/", "text/html"),
        ("/page.js", "text/javascript"),
        ("/view3d.js", "text/javascript"),
        ("/page.css", "text/css"),
        ("/theme.css", "text/css"),
    ):
        status, headers, body = ask(page, path)
        assert status == 200 and headers["Content-Type"].startswith(kind) and body
        assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"") and b"https://" not in body
        assert (
            headers["Cache-Control"] == "no-store"
            and headers["Referrer-Policy"] == "no-referrer"
            and headers["X-Frame-Options"] == "DENY"
        )
        assert (
            "default-src 'none'" in headers["Content-Security-Policy"]
            and "unsafe" not in headers["Content-Security-Policy"]
        )
    assert ask(page, "/image?camera=cam0")[0] == 404
    page.show(lambda: EVENT, {"cam0": lambda: b"\xff\xd8jpeg"})
    assert ask(page, "/image?camera=cam0")[2] == b"\xff\xd8jpeg"


@pytest.mark.parametrize("path", ["/", "/events", "/image?camera=cam0", "/page.js", "/nothing"])
def test_without_the_token_or_with_another_all_is_refused(page, path):
    assert ask(page, path, token=False)[0] == 403
    wrong = path + ("&" if "?" in path else "?") + "token=" + page.token[:-1] + ("A" if page.token[-1] != "A" else "B")
    assert ask(page, wrong, token=False)[0] == 403
    assert ask(page, path + ("&" if "?" in path else "?") + "token=%ff%fe", token=False)[0] == 403


@contextlib.contextmanager
def forwarded(page, address):
    """What `ssh -L` does: connections to an address go to the page's; the port that listens."""

    def pump(source, target):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def serve():
        with contextlib.suppress(OSError):
            while True:
                near = listener.accept()[0]
                far = socket.create_connection(("127.0.0.1", page.port))
                for pair in ((near, far), (far, near)):
                    ends.append(threading.Thread(target=pump, args=pair))
                    ends[-1].start()
                open_ones.extend((near, far))

    ends, open_ones = [], []
    with socket.create_server(address) as listener:
        ends.append(threading.Thread(target=serve))
        ends[-1].start()
        try:
            yield listener.getsockname()[1]
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            ends[0].join()
            for one in open_ones:
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
            for one in ends:
                one.join()
            for one in open_ones:
                one.close()


@pytest.mark.skipif(sys.platform != "linux", reason="127.0.0.2 stands for the other computer, which Linux alone has")
def test_a_forwarded_port_shows_the_page_under_the_same_number_alone(page):
    page.show(lambda: EVENT, {"cam0": lambda: b"\xff\xd8jpeg"})

    def asked(host, port, path, method="GET"):
        connection = http.client.HTTPConnection(host, port, timeout=10)
        at = f"127.0.0.1:{port}"  # as the other computer's browser has it
        connection.request(
            method, f"{path}?token={page.token}&camera=cam0", headers={"Host": at, "Origin": f"http://{at}"}
        )
        answer = connection.getresponse()
        found = answer.status, answer.readline() if path == "/events" else answer.read()
        connection.close()
        return found

    with forwarded(page, ("127.0.0.2", page.port)) as port:
        assert port == page.port
        assert [asked("127.0.0.2", port, path)[0] for path in ("/", "/page.js", "/image")] == [200] * 3
        assert b"moving to step 3" in asked("127.0.0.2", port, "/events")[1]
        assert asked("127.0.0.2", port, "/stop", "POST")[0] == 200 and page.presses == [True]
    with forwarded(page, ("127.0.0.1", 0)) as port:
        for path, method in (("/", "GET"), ("/events", "GET"), ("/stop", "POST")):
            status, text = asked("127.0.0.1", port, path, method)
            assert status == 403 and f"by ssh -L {page.port}:127.0.0.1:{page.port}" in text.decode()
    assert page.presses == [True]


def test_another_host_or_site_is_refused_even_with_the_token(page):
    for host in (
        "evil.example",
        f"evil.example:{page.port}",
        "127.0.0.1",
        f"127.0.0.1:{page.port + 1}",
        "",
        f"[::1]:{page.port}",
    ):
        assert ask(page, "/", host=host or " ")[0] == 403
    assert ask(page, "/", host=f"localhost:{page.port}")[0] == 200
    for origin in (
        "http://evil.example",
        "null",
        f"https://127.0.0.1:{page.port}",
        f"http://127.0.0.1:{page.port + 1}",
    ):
        assert ask(page, "/", headers=[("Origin", origin)])[0] == 403
        assert ask(page, "/stop", "POST", headers=[("Origin", origin)])[0] == 403
    assert ask(page, "/", headers=[("Sec-Fetch-Site", "cross-site")])[0] == 403
    assert ask(page, "/", headers=[("Sec-Fetch-Site", "same-site")])[0] == 403
    assert page.presses == []


def test_it_listens_on_the_loopback_alone(page):
    assert page._server.server_address[0] == "127.0.0.1"
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
    for address in others:
        with pytest.raises(OSError):
            socket.create_connection((address, page.port), timeout=2).close()


@pytest.mark.parametrize(
    "path",
    [
        "/../rig.toml",
        "/..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/page.html",
        "/page.py",
        "/server.py",
        "/page.js/../server.py",
        "/page.js%00.html",
        "/./page.js",
        "/PAGE.JS",
        "/image?camera=../../rig.toml",
        "http://evil.example/",
        "/image/../stop",
        "\\..\\server.py",
    ],
)
def test_path_tricks_are_refused(page, path):
    assert ask(page, path)[0] in (403, 404)


def test_the_button_needs_a_post_from_this_page(page):
    here = ("Origin", f"http://127.0.0.1:{page.port}")
    assert ask(page, "/stop")[0] == 404 and page.presses == []
    assert ask(page, "/stop", "POST")[0] == 403
    assert ask(page, "/stop", "POST", token=False, headers=[here])[0] == 403
    assert ask(page, "/", "POST", headers=[here])[0] == 404
    assert ask(page, "/stop", "POST", headers=[here, ("Content-Length", "5")])[0] == 403
    assert page.presses == []
    assert ask(page, "/stop", "POST", headers=[here])[0] == 200 and page.presses == [True]
    assert ask(page, "/stop", "PUT", headers=[here])[0] == 501


def test_events_come_as_they_are_shown_and_end_with_the_run(page):
    page.show(lambda: {"phase": "one"})
    stream = socket.create_connection(("127.0.0.1", page.port), timeout=10)
    stream.sendall(f"GET /events?token={page.token} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
    with stream, stream.makefile("rb") as lines:
        while lines.readline().strip():
            pass
        assert json.loads(lines.readline()[6:]) == {"phase": "one"}
        lines.readline()
        page.show(lambda: {"phase": "two"})
        assert json.loads(lines.readline()[6:]) == {"phase": "two"}
        page.close()
        rest = lines.read()
    assert b"event: end" in rest
    page.close = lambda: None
    made = PageServer(lambda: None)
    assert [made.take_line(+1) for _ in range(17)].count(False) == 1
    made.close()


def test_a_run_says_that_it_is_alive_well_within_the_time_that_its_page_waits(page):
    silent = re.search(r"SILENT = ([\d.]+)", resources.files("rig.report.pages").joinpath("page.js").read_text())
    assert 3 * ALIVE * 1e3 <= float(silent[1]) <= 2e3
    stream = socket.create_connection(("127.0.0.1", page.port), timeout=60)
    stream.sendall(f"GET /events?token={page.token} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
    with stream, stream.makefile("rb") as lines:
        while lines.readline().strip():
            pass
        lines.readline(), lines.readline()  # what is shown now
        assert [lines.readline() for _ in range(6)] == [b"event: alive\n", b"data: {}\n", b"\n"] * 2


# the page's script on a document that holds what is set on its elements; time passes as the test says
PAGE = """
import { readFileSync } from "node:fs";
const elements = {};
const blank = () => new Proxy({ style: {}, children: [], append() {}, replaceChildren() {}, setAttribute() {},
  addEventListener() {} }, {});
const getElementById = (id) => (elements[id] ??= blank());
globalThis.document = { getElementById, createElement: blank, createElementNS: blank };
globalThis.location = { search: "?token=x" };
let now = 0, tick;
globalThis.performance = { now: () => now };
globalThis.setInterval = (called) => { tick = called; };
const heard = {};
globalThis.EventSource = class { constructor() { heard.source = this; }
  addEventListener(name, called) { heard[name] = called; }
  close() {} };
const code = readFileSync(process.argv[1], "utf-8").replace(/const . Rig .*/, "const Rig = class { show() {} };");
await import("data:text/javascript," + encodeURIComponent(code));
const look = () => console.log(JSON.stringify({ state: elements.state.textContent, badge: elements.state.className,
  stop: !!elements.stop.disabled, far: elements.far.textContent, phase: elements.phase.textContent }));
const event = process.argv[2];
heard.source.onmessage({ data: event });
const pass = (ms) => { for (let k = 0; k < ms; k += 100) { now += 100; if (now % 500 === 0) tick(); } };
pass(1000); heard.alive({}); pass(1000); look();
pass(1000); look();
heard.alive({}); look();
heard.source.onmessage({ data: event.replace('"ended": null', '"ended": ""') }); pass(5000); look();
"""


def test_the_page_of_a_run_that_was_killed_says_within_two_seconds_that_it_is_dead():
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Node: apt-get install nodejs")
    script = str(resources.files("rig.report.pages").joinpath("page.js"))
    event = json.dumps({**EVENT, "verdict": {"state": "good", "why": "all is well"}, "seen": None})
    done = subprocess.run(
        [node, "--input-type=module", "-e", PAGE, script, event], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    going, dead, back, over = map(json.loads, done.stdout.splitlines())
    assert going["state"] == "good" and "1:15 left" in going["far"] and not going["stop"]
    assert dead["state"] == "dead" and dead["badge"] == "badge bad" and dead["stop"] is True
    assert "left" not in dead["far"] and "rig stop" in dead["phase"]
    assert back["state"] == "good" and back["stop"] is False, "it had only been held up"
    assert over["state"] == "good" and over["stop"] is True, "a run that is over is not dead"


def test_nothing_is_drawn_that_nobody_looks_at_and_once_for_all_who_do(page):
    drawn, sent = [], []

    def event():
        drawn.append(1)
        return {"phase": len(drawn)}

    for _ in range(5):
        page.show(event, {"cam0": lambda: sent.append(1) or b"jpeg"})
    assert drawn == sent == []
    assert [page.listen(-1, 0)[1] for _ in range(3)] == [b'{"phase": 1}'] * 3 and drawn == [1]
    assert {page.image("cam0") for _ in range(3)} == {b"jpeg"} and sent == [1]
    page.show(event)
    assert page.listen(5, 0)[1] == b'{"phase": 2}' and page.image("cam0") == b"jpeg"


def test_strangers_neither_use_up_files_nor_shut_out_who_has_the_token(page):
    flood = (
        "import socket, sys\nopen_ones = []\n"
        "for k in range(200):\n"
        "    one = socket.create_connection(('127.0.0.1', int(sys.argv[1])))\n"
        "    one.sendall(b'GET / HTTP/1.1\\r\\n' + (b'', b'Host: x\\r\\n\\r\\n')[k % 2])\n"
        "    open_ones.append(one)\n"
        "print('done', flush=True)\nsys.stdin.read()\n"
    )
    page.show(lambda: EVENT, {"cam0": lambda: b"jpeg"})
    before = len(os.listdir("/proc/self/fd"))
    with subprocess.Popen(
        [sys.executable, "-c", flood, str(page.port)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        answered, most = 0, 0
        while process.stdout not in select.select([process.stdout], [], [], 0)[0]:
            assert ask(page, "/")[0] == ask(page, "/image?camera=cam0")[0] == 200
            answered, most = answered + 1, max(most, len(os.listdir("/proc/self/fd")))
        assert answered and most - before <= STRANGERS + 12, "those at work on their end are a few more"
        assert len(page._server.strangers) <= STRANGERS
        assert ask(page, "/")[0] == 200
        process.communicate(b"")


@pytest.mark.parametrize("between", [" \x01", "\x1f", "\t"])
def test_a_request_with_control_characters_presses_no_button(page, between):
    with socket.create_connection(("127.0.0.1", page.port), timeout=20) as asking:
        asking.sendall(
            f"POST{between}/stop?token={page.token} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n"
            f"Origin: http://127.0.0.1:{page.port}\r\n\r\n".encode()
        )
        assert b" 403 " in asking.recv(100) and page.presses == []


def test_who_sends_no_request_in_time_is_parted_with(page, monkeypatch):
    monkeypatch.setattr(run_page_server, "HEADERS_WITHIN", 0.2)
    slow = socket.create_connection(("127.0.0.1", page.port), timeout=20)
    slow.sendall(b"GET / HTTP/1.1\r\nHost: ")
    assert slow.recv(1) == b"" and not page._server.strangers
    slow.close()


def test_so_many_with_the_token_and_no_more(page, monkeypatch):
    monkeypatch.setattr(run_page_server, "KNOWN", 2)
    page.show(lambda: EVENT)
    request = f"GET /page.js?token={page.token} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode()
    lasting = [socket.create_connection(("127.0.0.1", page.port), timeout=20) for _ in range(2)]
    for one in lasting:
        one.sendall(request)
        assert one.recv(12) == b"HTTP/1.1 200"
    assert ask(page, "/")[0] == 503
    for one in lasting:
        one.close()
    while page._server.known:
        time.sleep(0.001)
    assert ask(page, "/")[0] == 200


@pytest.mark.parametrize("path", ["/?" + "a=1&" * 50, "//[/", "/?token=" + "x" * 5000, "/" + "%00" * 50])
def test_addresses_that_are_none_are_refused_in_words(page, path):
    assert ask(page, path, token=False)[0] in (400, 403)


@pytest.mark.slow
def test_a_browser_shows_it(page, tmp_path):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    page.show(lambda: {**EVENT, "ended": ""}, {})
    with subprocess.Popen(
        [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={tmp_path}",
            "--virtual-time-budget=3000",
            "--dump-dom",
            page.url,
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as running:
        end = time.monotonic() + 120
        while not page._lines:  # until the browser listens
            assert running.poll() is None and time.monotonic() < end
            time.sleep(0.005)
        page.close()
        shown = running.communicate(timeout=120)[0]
    page.close = lambda: None
    assert "frame 2 of 9, step 3 of 10, 1:15 left" in shown
    assert "&lt;b&gt;moved&lt;/b&gt;" in shown, "what the run says is text, never markup"
    assert (
        shown.count('class="strut"') == 6
        and "0.020 px" in shown
        and 'class="quad"' in shown
        and 'class="arrow"' in shown
    )
    assert "next: 1 frame there, step 4 (12.3 mm)" in shown and "no emergency stop" in shown
    assert "ambient_temperature_C" in shown and "1:01" in shown and "jump: &lt;b&gt;strut 2&lt;/b&gt;" in shown
    assert "450.000 mm" in shown and "0.21 s after its exposure" in shown and 'class="curve"' in shown
