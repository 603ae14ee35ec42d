"""Cameras of the user's own: a file, a program that is run for each image, a stream behind a URL."""

import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

from rig.driving.cameras import CameraError, open_camera
from rig.driving.driving_clock import SystemClock
from rig.errors import FileError
from tests.rig.driving.cameras.test_cameras import camera
from tests.rig.simulated_clock import SIZE, Ticking

FILE = '''"""A camera that gives the number of the image."""

import numpy as np

from rig.driving.base import UserCamera


class Mine(UserCamera):
    count = 0

    def grab(self):
        self.count += 1
        return np.full((self.camera.height, self.camera.width), self.count, np.uint8)
'''
FAILS = [
    ("self.count, np.uint8", "self.count, float", r"'cam0' gives float64 \(24, 32\), not an array of uint8"),
    ("self.camera.width)", "self.camera.width, 4)", "'cam0' gives 4 values for each pixel"),
    ("self.camera.height, self", "2, self", "'cam0' gives 32 x 2 px, but rig.toml has 32 x 24 px"),
    ("return np.full", "return np.fill", "mine.py:13: Mine.grab fails: AttributeError"),
    ("        return np.full(", "        (", "'cam0' gives NoneType, not an array"),
]
LACKS = [
    ("def grab(", "def take(", "mine.py:8: Mine lacks grab, which returns an image"),
    ("(UserCamera)", "", r"mine.py: defines no camera: class Mine\(UserCamera\), from rig.driving.base"),
    ("count = 0", "count = ", "mine.py:9:.*is no Python"),
]
WRITER = (
    "import sys, cv2, numpy; "
    "sys.stdout.buffer.write(cv2.imencode('.png', numpy.full((int(sys.argv[3]), int(sys.argv[2])), 9, 'uint8'))[1])"
)


def written(folder, old="", new=""):
    assert old in FILE
    (folder / "mine.py").write_text(FILE.replace(old, new, 1) if old else FILE)
    return camera(f"file:{folder / 'mine.py'}")


def test_a_file_may_stamp_its_images(tmp_path):
    clock = Ticking()
    stamp = clock.now() - 0.3
    source = open_camera(written(tmp_path, "self.count, np.uint8)", f"self.count, np.uint8), {stamp}, 2e-4"), clock)
    frame = source.grab()
    assert (frame.t, frame.t_sigma) == (stamp, 2e-4) and frame.image[0, 0] == 1
    for given, why in (("12.0, 1e-4", "is t in seconds since 1970"), ("1e9", "not enough values")):
        (tmp_path / "mine.py").write_text(FILE.replace("self.count, np.uint8)", f"self.count, np.uint8), {given}"))
        other = tmp_path / given[:2]
        other.mkdir()
        (other / "other.py").write_text((tmp_path / "mine.py").read_text())
        with pytest.raises(CameraError, match=why):
            open_camera(camera(f"file:{other / 'other.py'}"), clock).grab()


def test_a_file_gives_images_that_are_timed_by_the_host(tmp_path):
    clock = Ticking()
    source = open_camera(written(tmp_path), clock)
    grab, source._user.grab = source._user.grab, lambda: (clock.sleep(0.12), grab())[1]
    source._guarded = lambda call: call
    before = clock.now()
    frames = [source.grab() for _ in range(2)]
    assert [frame.image[0, 0] for frame in frames] == [1, 2] and not source.can_set_exposure
    assert frames[0].t == pytest.approx(before + 0.06) and frames[0].t_sigma == pytest.approx(0.12 / 12**0.5)
    source.close()


@pytest.mark.parametrize("old, new, message", FAILS)
def test_a_camera_that_fails_is_named(tmp_path, old, new, message):
    source = open_camera(written(tmp_path, old, new), Ticking())
    with pytest.raises(CameraError, match=message):
        source.grab()
    with pytest.raises(CameraError, match="does not set its exposure"):
        source.set_exposure(0.01)


@pytest.mark.parametrize("old, new, message", LACKS)
def test_a_file_that_is_no_camera_is_refused_with_its_line(tmp_path, old, new, message):
    with pytest.raises(FileError, match=message):
        open_camera(written(tmp_path, old, new), Ticking())


def test_a_program_is_run_for_each_image(tmp_path):
    (tmp_path / "w.py").write_text(WRITER)
    source = open_camera(
        camera(f"command:{sys.executable} {tmp_path}/w.py {{name}} {{width}} {{height}}"), SystemClock()
    )
    for _ in range(2):
        frame = source.grab()
        assert frame.image.shape == SIZE[::-1] and frame.image[0, 0] == 9 and 0 < frame.t_sigma < 10
    source.close()


@pytest.mark.parametrize(
    "command, message",
    [
        ("/none/such", "'cam0': /none/such cannot be run: No such file"),
        ("{python} -c 'import sys; sys.exit(\"no light\")'", "ended with 1: no light"),
        ("{python} -c 'print(7)'", "contains no image of readable size"),
        ("{python} {writer} cam0 8 6", "gives 8 x 6 px, but rig.toml has 32 x 24 px"),
        ("a 'b", "cannot be parsed"),
    ],
)
def test_a_program_that_gives_no_image_is_named(tmp_path, command, message):
    (tmp_path / "w.py").write_text(WRITER)
    words = command.replace("{python}", sys.executable).replace("{writer}", str(tmp_path / "w.py"))
    with pytest.raises(CameraError, match=message):
        open_camera(camera(f"command:{words}"), SystemClock()).grab()


def test_a_program_without_a_shell_gets_no_input_and_is_ended(tmp_path):
    from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import CommandSource

    source = CommandSource(camera(), f"{sys.executable} -c 'import time; time.sleep(60)'", SystemClock(), wait=0.2)
    with pytest.raises(CameraError, match="gave no image in 0.2 s"):
        source.grab()
    with pytest.raises(CameraError, match="exposure is set by its program"):
        source.set_exposure(0.1)


class Stream(BaseHTTPRequestHandler):
    """A stream of JPEG images, each brighter than the one before, ten a second."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        for k in range(200):
            image = cv2.imencode(".jpg", np.full((SIZE[1], SIZE[0]), k, np.uint8))[1].tobytes()
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(image)}\r\n\r\n".encode()
            try:
                self.wfile.write(head + image + b"\r\n")
            except OSError:
                return
            if self.server.ended.wait(0.1):
                return

    def log_message(self, *given):
        pass


def test_a_stream_behind_a_url_gives_fresh_images():
    with ThreadingHTTPServer(("127.0.0.1", 0), Stream) as server:
        server.ended = threading.Event()
        threading.Thread(target=server.serve_forever, daemon=True).start()
        clock = SystemClock()
        source = open_camera(camera(f"http://127.0.0.1:{server.server_port}/video"), clock)
        before = clock.now()
        first = source.grab()
        second = source.grab()
        server.ended.set()
        source.close()
        server.shutdown()
    assert first.image.shape[:2] == SIZE[::-1] and not source.can_set_exposure
    assert before <= first.t < second.t and second.image.mean() > first.image.mean()


def test_a_url_where_nothing_is_sent_is_named_without_its_password():
    with pytest.raises(CameraError, match="'cam0': http://..@127.0.0.1:9/x sends no video"):
        open_camera(camera("http://me:secret@127.0.0.1:9/x"), SystemClock())
