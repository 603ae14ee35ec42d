"""Cameras behind rtsp:// URLs, of a GStreamer RTSP server in another process.

RTSP_PYTHON=PROGRAM names an interpreter that has gi and GstRtspServer (apt install python3-gi
gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-good gstreamer1.0-plugins-ugly); by default it is the system's.
"""

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from rig.driving.cameras import CameraError, open_camera
from rig.driving.driving_clock import SystemClock
from tests.rig.driving.cameras.test_cameras import camera

pytestmark = pytest.mark.slow
SERVER = Path(__file__).with_name("rtsp_server.py")
SIZE = (160, 120)


class Server:
    """The server's process, which can be killed."""

    def __init__(self):
        program = os.environ.get("RTSP_PYTHON", "/usr/bin/python3")
        if not Path(program).exists():
            pytest.skip(f"there is no {program}; RTSP_PYTHON names an interpreter with GstRtspServer")
        self.process = subprocess.Popen(
            [program, SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        )
        self.port = self.process.stdout.readline().strip()
        if not self.port:
            words = self.process.communicate()[1].strip()
            pytest.skip(f"no RTSP server by {program}: {words.splitlines()[-1]}; RTSP_PYTHON names another interpreter")

    def send(self, pattern):
        self.process.stdin.write(f"{pattern}\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == f"{pattern}\n"

    def kill(self):
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def server():
    made = Server()
    yield made
    made.kill()


def opened(server, path, size=SIZE):
    stated = replace(camera(f"rtsp://127.0.0.1:{server.port}/{path}"), width=size[0], height=size[1])
    return open_camera(stated, SystemClock())


@pytest.mark.parametrize("path", ["h264", "jpeg"])
def test_images_are_those_that_are_sent_and_follow_what_changes(server, path, capsys):
    clock, source = SystemClock(), opened(server, path)
    assert not source.can_set_exposure
    for pattern, is_so in (("black", lambda grey: grey < 30), ("white", lambda grey: grey > 225)):
        server.send(pattern)
        before, grabbed = clock.now(), 0
        while not is_so((frame := source.grab()).image.mean()):
            grabbed += 1
            assert grabbed < 4, "images of long ago"
        assert frame.image.shape == (*SIZE[::-1], 3) and before <= frame.t <= clock.now() and 0 < frame.t_sigma < 0.1
        with capsys.disabled():
            print(f"\n{path}: {pattern} after {grabbed} images of before, {1e3 * (clock.now() - before):.0f} ms")
    source.close()


def test_a_server_that_dies_or_has_no_such_stream_is_named(server):
    with pytest.raises(CameraError, match=rf"rtsp://127.0.0.1:{server.port}/other sends no video"):
        opened(server, "other")
    with pytest.raises(CameraError, match="gives 160 x 120 px, but rig.toml has 320 x 240 px"):
        opened(server, "jpeg", (320, 240)).grab()
    source = opened(server, "jpeg")
    source.grab()
    server.kill()
    with pytest.raises(CameraError, match="gives no frame|gave no fresh frame"):
        for _ in range(20):  # what was on its way
            source.grab()
    source.close()
