"""GenICam cameras through harvesters and a maker's producer: Aravis' fake GigE Vision camera, settings and failures.

GENTL_PRODUCER=FILE.cti names a producer for GigE Vision; arv-fake-gv-camera-0.8 comes with Debian's aravis-tools.
"""

import os
import shutil
import signal
import socket
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest

from rig.driving.cameras import CameraError, open_camera
from rig.driving.driving_clock import SystemClock
from rig.model.design import Camera, CaptureSettings
from rig.model.pose import pose

SERIAL, SIDE, FAKE = "RIG01", 512, "arv-fake-gv-camera-0.8"
CAMERA = Camera(
    "cam0", SIDE, SIDE, np.diag([30.0, 30, 1]), np.zeros(5), pose([0, 0, 0], [0, 0, 0]), source=f"genicam:{SERIAL}"
)
ROWS = r"""
/* Aravis 0.8.26 states 0 rows in the trailer of an image, which producers take for its height: 512 are stated here.
   A trailer: status 2 bytes, block 2, format 1 (2), packet 3, reserved 2, payload type 2 (1: image), rows 4 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <sys/socket.h>
static void state_rows(uint8_t *p, size_t n) {
    if (n == 16 && p[4] == 2 && p[11] == 1 && !p[12] && !p[13] && !p[14] && !p[15]) p[14] = 2;
}
ssize_t sendmsg(int s, const struct msghdr *m, int flags) {
    ssize_t (*real)(int, const struct msghdr *, int) = dlsym(RTLD_NEXT, "sendmsg");
    if (m->msg_iovlen == 1) state_rows(m->msg_iov[0].iov_base, m->msg_iov[0].iov_len);
    return real(s, m, flags);
}
ssize_t sendto(int s, const void *b, size_t n, int flags, const struct sockaddr *a, socklen_t l) {
    ssize_t (*real)(int, const void *, size_t, int, const struct sockaddr *, socklen_t) = dlsym(RTLD_NEXT, "sendto");
    state_rows((uint8_t *)b, n);
    return real(s, b, n, flags, a, l);
}
"""


def own_address():
    """The address of an interface that leads elsewhere; producers ignore the loopback. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            pytest.skip("this computer has no network interface but the loopback")
        return probe.getsockname()[0]


@pytest.fixture(scope="module")
def producer():
    path = os.environ.get("GENTL_PRODUCER", "")
    if not path:
        pytest.skip("GENTL_PRODUCER names no GenTL producer (.cti) for GigE Vision")
    pytest.importorskip("harvesters", reason="harvesters is not installed")
    for program in (FAKE, "cc"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    return path


@pytest.fixture
def fake_camera(producer, tmp_path, monkeypatch):
    """A fake camera's process, once it sends images."""
    monkeypatch.setenv("GENICAM_GENTL64_PATH", os.path.dirname(producer))
    (tmp_path / "rows.c").write_text(ROWS)
    library = tmp_path / "rows.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "rows.c", "-ldl"], check=True)
    command = [FAKE, "-i", own_address(), "-s", SERIAL]
    with subprocess.Popen(command, env={**os.environ, "LD_PRELOAD": str(library)}) as process:
        try:
            time.sleep(1.0)
            run_freely(producer)
            yield process
        finally:
            process.kill()


def run_freely(producer):
    """The first images of this fake take seconds, and it sends none that are triggered before."""
    from harvesters.core import Harvester

    harvester = Harvester()
    harvester.add_file(producer)
    harvester.update()
    serials = [info.serial_number for info in harvester.device_info_list]
    acquirer = harvester.create(serials.index(SERIAL))
    acquirer.remote_device.node_map.TriggerMode.value = "Off"
    acquirer.start()
    with acquirer.fetch(timeout=20.0) as buffer:
        assert buffer.payload.components[0].height == SIDE
    acquirer.stop()
    acquirer.destroy()
    harvester.reset()


def opened(**settings):
    return open_camera(replace(CAMERA, capture=CaptureSettings(**settings)), SystemClock())


@pytest.mark.slow
def test_a_gige_camera_is_exposed_by_the_run_in_every_pixel_format(fake_camera):
    clock, colours = SystemClock(), {}
    for form in ("Mono8", "Mono16", "BayerRG8", "BayerBG8", "BayerGB8", "BayerGR8", "RGB8"):
        source = opened(pixel_format=form)
        levels = []
        for exposure in (0.004, 0.008):
            assert source.set_exposure(exposure) == exposure
            before = clock.now()
            frame = source.grab()
            assert before < frame.t < clock.now() and abs(frame.t - before - exposure / 2) < 0.1
            assert frame.image.dtype == (np.uint16 if form == "Mono16" else np.uint8)
            assert frame.image.shape == ((SIDE, SIDE) if form.startswith("Mono") else (SIDE, SIDE, 3))
            levels.append(frame.image.mean())
        if form.startswith("Mono"):
            assert levels[1] > 1.2 * levels[0], "the fake's images are brighter with its exposure"
        else:
            colours[form] = frame.image[8:-8, 8:-8].mean((0, 1))
        source.close()
    truth = colours.pop("RGB8")
    for form, colour in colours.items():
        exchanged = form in ("BayerRG8", "BayerBG8")  # of red and blue, by Aravis 0.8.26; GStreamer agrees with rig
        np.testing.assert_allclose(colour, truth[::-1] if exchanged else truth, atol=3.0, err_msg=form)


@pytest.mark.slow
def test_what_a_gige_camera_does_not_take_is_named_and_it_can_be_opened_again(fake_camera):
    for settings, says in (
        ({"pixel_format": "Mono12"}, "does not take PixelFormat = Mono12"),
        ({"gain": 3.0}, "has no gain in dB: none of Gain, GainAbs"),
        ({"trigger": "Line7"}, "does not take TriggerSource = Line7"),
        ({"strobe": "Line2"}, "does not take LineSelector = Line2: it has no LineSelector"),
        ({"ptp": True}, "does not keep time by PTP: it has no PtpEnable"),
    ):
        with pytest.raises(CameraError, match=says):
            opened(**settings)
    with pytest.raises(CameraError, match="no GenICam camera 'RIG02'; there are .*'RIG01'"):
        open_camera(replace(CAMERA, source="genicam:RIG02"), SystemClock())
    source = open_camera(replace(CAMERA, height=480), SystemClock())
    with pytest.raises(CameraError, match="gives 512 x 512 px, but rig.toml has 512 x 480 px"):
        source.grab()
    with pytest.raises(CameraError, match="'RIG01' is there and cannot be opened"):
        opened()
    source.close()
    source = opened(trigger="Line0")
    assert not source.can_set_exposure
    source.arm()
    with pytest.raises(CameraError, match="gave no image in 5 s after an edge at Line0"):
        source.grab()
    source.close()


@pytest.mark.slow
def test_a_gige_camera_that_is_unplugged_is_named_and_let_go_of(fake_camera):
    source = opened()
    source.grab()
    os.kill(fake_camera.pid, signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(CameraError, match="'cam0' does not answer; is it plugged in, and free"):
            source.grab()
    source.close()
    with pytest.raises(CameraError, match="no GenICam camera 'RIG01'; there are none"):
        opened()
