"""Cameras: fresh frames only, their times on the host's clock, whole files only."""

import contextlib
import threading
import time
import tomllib
import types
from dataclasses import replace

import cv2
import numpy as np
import pytest

from rig.driving.cameras import (
    CameraError,
    genicam_harvester_interface_and_camera_discovery,
    open_camera,
    opencv_uvc_gstreamer_and_network_cameras,
)
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    ClockOffset,
    Frame,
    StampDifferences,
    SynchronisedCameras,
)
from rig.driving.cameras.camera_opening_with_folder_and_emulator_sources import EmulatedSource, FolderSource
from rig.driving.cameras.genicam_camera import PTP_NODES, GenicamSource
from rig.driving.cameras.opencv_uvc_gstreamer_and_network_cameras import GuardedCapture, VideoSource
from rig.errors import FileError, RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Camera, CaptureSettings
from rig.model.pose import pose
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.conftest import ROOT
from tests.rig.simulated_clock import SIZE, Ticking


def camera(source=None):
    return Camera("cam0", *SIZE, np.diag([30.0, 30, 1]), np.zeros(5), pose([0, 0, 0], [0, 0, 0]), source=source)


class Capture:
    """A free-running cv2.VideoCapture: a frame every 0.1 s, up to four wait; stamped by a clock that is `off` s behind,
    where it stamps.
    """

    def __init__(self, clock, stamps, off=700.0):
        self.clock, self.stamps, self.off, self.frame_number, self.released = (
            clock,
            stamps,
            off,
            round(clock.t * 10) - 20,
            False,
        )

    def grab(self):
        self.frame_number = max(self.frame_number + 1, int(self.clock.t * 10) - 3)
        self.clock.t = max(self.clock.t, self.frame_number / 10)
        return True

    def get(self, key):
        return (self.frame_number / 10 - self.off) * 1e3 if self.stamps else 0.0

    def retrieve(self):
        return True, np.full((SIZE[1], SIZE[0]), self.frame_number % 256, np.uint8)

    def set(self, key, value):
        return True

    def release(self):
        self.released = True


@pytest.mark.parametrize("stamps", [True, False])
def test_a_video_frame_is_fresh_and_its_time_is_the_hosts(stamps):
    clock = Ticking()
    source = VideoSource("cam0", Capture(clock, stamps), clock, SIZE)
    source.set_exposure(0.02)
    for _ in range(6):
        clock.sleep(1.234)
        before = clock.now()
        frame = source.grab()
        arrived = clock.now()
        assert frame.image[0, 0] == round(arrived * 10) % 256, "the frame that came last, not one that waited"
        assert before <= frame.t <= arrived
        assert abs(frame.t - (arrived - 0.01)) <= 2 * frame.t_sigma
        assert frame.t_sigma < 0.06


def test_frames_that_wait_in_a_stream_are_let_go_by_however_many():
    clock = Ticking()
    capture = Capture(clock, False)
    grab, waiting = capture.grab, iter(range(30))
    capture.grab = lambda: next(waiting, None) is not None or grab()
    with pytest.raises(CameraError, match="gave 11 frames, none of them known to be exposed after the request"):
        VideoSource("cam0", capture, clock, SIZE).grab()
    waiting, before = iter(range(2000)), clock.now()  # as of a minute between two exposures
    assert VideoSource("cam0", capture, clock, SIZE, uvc=False, queue=None).grab().t >= before


def test_a_video_camera_that_is_gone_or_of_another_size_is_named():
    clock = Ticking()
    capture = Capture(clock, True)
    with pytest.raises(CameraError, match="'cam0' gives 32 x 24 px, but rig.toml has 24 x 32"):
        VideoSource("cam0", capture, clock, SIZE[::-1]).grab()
    capture.grab = lambda: False
    with pytest.raises(CameraError, match="plugged in"):
        VideoSource("cam0", capture, clock, SIZE).grab()


READING = [
    "v4l2src ! videoconvert ! appsink",
    "v4l2src device=/dev/video0 ! video/x-raw, width=1280, format=(string)BGR ! videoconvert ! appsink",
    "rtspsrc location=rtsp://u:p@h/x?a=b latency=0 ! rtph264depay ! avdec_h264 ! queue ! appsink drop=true",
    "nvarguscamerasrc ! video/x-raw(memory:NVMM),width=1280,framerate=30/1 ! nvvidconv ! appsink",
]
WRITING = [
    "v4l2src ! filesink location={}",
    "v4l2src ! tee name=t ! appsink t. ! filesink location={}",
    "v4l2src ! file://{}",
    "v4l2src ! video/x-raw",
    "v4l2src ! appsink filesrc location=a ! filesink location={}",
    "playbin video-sink=filesink ! appsink",
    "appsink",
    "v4l2src ! splitmuxsink location={} ! appsink",
    "camerabin location={} ! appsink",
    "v4l2src ! queue2 temp-template={} ! appsink",
    "v4l2src name='a ! filesink location={} v4l2src ! appsink",
    "bin.( v4l2src ! filesink location={} ) ! appsink",
    "v4l2src ! appsink t. ! filesink location={}",
]


def test_a_pipeline_opens_only_what_reads_decodes_and_converts(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda kind: kind == cv2.CAP_GSTREAMER)
    closed = types.SimpleNamespace(isOpened=lambda: False, release=lambda: None)
    monkeypatch.setattr(cv2, "VideoCapture", lambda place, kind: opened.append(place) or closed)
    for text in WRITING:
        with pytest.raises(
            CameraError, match="'cam0': gstreamer:.*(may write|must end in appsink|no setting|name an image source)"
        ):
            open_camera(camera("gstreamer:" + text.format(tmp_path / "written")), Ticking())
    assert not opened
    for text in READING:
        with pytest.raises(CameraError, match="cannot be opened"):
            open_camera(camera(f"gstreamer:{text}"), Ticking())
    assert opened == [text if "drop=" in text else f"{text} drop=true" for text in READING]


def test_an_opencv_that_lists_gstreamer_and_cannot_load_it_says_so(monkeypatch):
    monkeypatch.setattr(cv2.videoio_registry, "getBackends", lambda: (cv2.CAP_GSTREAMER,))  # as a plug-in, not there
    monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda kind: False)
    with pytest.raises(CameraError, match="this build of OpenCV has no GStreamer"):
        open_camera(camera("gstreamer:videotestsrc ! videoconvert ! appsink"), Ticking())


def test_a_pipeline_that_falls_silent_is_gone_and_not_waited_for_again(monkeypatch):
    silent, released = threading.Event(), []
    monkeypatch.setattr(opencv_uvc_gstreamer_and_network_cameras, "WAIT", 0.05)
    capture = types.SimpleNamespace(grab=silent.wait, release=lambda: released.append(1))
    source = VideoSource("cam0", GuardedCapture(capture), Ticking(), SIZE, uvc=False)
    for _ in range(2):
        with pytest.raises(CameraError, match="'cam0' gives no frame; is it plugged in"):
            source.grab()
    source.close()
    assert not released, "a call still waits in it"
    silent.set()


def test_a_pipeline_that_never_opens_is_named(monkeypatch):
    silent = threading.Event()
    monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda kind: True)
    monkeypatch.setattr(opencv_uvc_gstreamer_and_network_cameras, "OPENING", 50)
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: silent.wait())
    with pytest.raises(CameraError, match="cannot be opened; `gst-launch-1.0 nosuchsrc ! fakesink` states why"):
        open_camera(camera("gstreamer:nosuchsrc ! appsink"), Ticking())
    silent.set()


def test_a_device_that_is_not_there_is_said(tmp_path):
    with pytest.raises(CameraError, match="cannot be opened"):
        open_camera(camera(f"uvc:{tmp_path}/video9"), Ticking())
    with pytest.raises(CameraError, match="has no source"):
        open_camera(camera(), Ticking())


def test_offset_narrows_drifts_and_sees_a_clock_set_anew():
    rng, offset = np.random.default_rng(2), ClockOffset()
    t, true = 100.0, 37.25
    for _ in range(50):
        before, latency = t, rng.uniform(0.001, 0.03, 2)
        offset.learn(before, before + latency[0] - true, before + latency.sum())
        t += 1.0
    at, sigma = offset.host(500.0, t)
    assert abs(at - (500.0 + true)) < 2 * sigma and sigma < 2e-3
    assert offset.host(500.0, t + 1000)[1] > 0.05, "what was known of two clocks wears out"
    offset.learn(t, t - 5.0, t + 0.01)
    assert offset.restarts == 1 and offset.host(t - 5.0, t)[0] == pytest.approx(t, abs=0.011)
    with pytest.raises(RigError, match="backwards"):
        offset.learn(2.0, 0.0, 1.0)


class Node:
    def __init__(self, value=None, run=None):
        self.value, self.min, self.max, self.execute = value, 10.0, 1e5, run


def genicam(clock, data_format="Mono12", off=250.0, latency=0.004):
    """A harvesters ImageAcquirer that isn't there: stamps its exposures by a clock that is `off` s behind."""
    nodes = types.SimpleNamespace(
        ExposureTime=Node(5000.0), TriggerMode=Node(), TriggerSource=Node(), ExposureAuto=Node()
    )
    acquirer = types.SimpleNamespace(remote_device=types.SimpleNamespace(node_map=nodes), started=False)
    exposed = []

    def trigger():
        clock.sleep(latency)
        exposed.append(clock.now())
        clock.sleep(0.001)

    class Buffer:
        timestamp_ns = 0

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.payload.components[0].data[:] = 0  # the producer takes it back

    def fetch(timeout):
        if not exposed:
            raise TimeoutError("no buffer")
        clock.sleep(0.02)
        buffer = Buffer()
        buffer.timestamp_ns = int((exposed[-1] - off) * 1e9)
        data = np.full(SIZE[0] * SIZE[1], 4095 if data_format != "Mono8" else 255, np.uint16)
        buffer.payload = types.SimpleNamespace(
            components=[types.SimpleNamespace(width=SIZE[0], height=SIZE[1], data_format=data_format, data=data)]
        )
        return buffer

    nodes.TriggerSoftware = Node(run=trigger)
    acquirer.start, acquirer.stop, acquirer.destroy, acquirer.fetch = (
        (lambda: None),
        (lambda: None),
        (lambda: None),
        fetch,
    )
    return acquirer, nodes, exposed


def test_a_genicam_camera_is_triggered_and_its_stamp_brought_to_the_host():
    clock = Ticking()
    acquirer, nodes, exposed = genicam(clock)
    source = GenicamSource("cam0", acquirer, clock, SIZE)
    assert (
        nodes.TriggerMode.value == "On"
        and nodes.TriggerSource.value == "Software"
        and nodes.ExposureAuto.value == "Off"
    )
    assert source.set_exposure(0.002) == pytest.approx(0.002) and source.set_exposure(9.0) == pytest.approx(0.1)
    source.set_exposure(0.01)
    for _ in range(4):
        clock.sleep(0.5)
        frame = source.grab()
        assert abs(frame.t - (exposed[-1] + 0.005)) <= 2 * frame.t_sigma < 0.04
        assert frame.image.dtype == np.uint16 and frame.image.max() == 65520 and frame.image.shape == SIZE[::-1]
    nodes.TimestampLatch = Node(run=lambda: setattr(nodes, "TimestampLatchValue", Node((clock.now() - 250.0) * 1e9)))
    nodes.TimestampLatchValue = Node(0)
    sharper = source.grab()
    assert sharper.t_sigma < 1e-3 and abs(sharper.t - (exposed[-1] + 0.005)) < 3e-3


def with_nodes(nodes, *names):
    for name in names:
        setattr(nodes, name, Node())


def wired(clock):
    """Two cameras, the first exposes the second by its strobe: the second and the first as sources, nodes of the
    first and the second, times at which the first exposed, the second's queue of times.
    """
    first, nodes, exposed = genicam(clock)
    second, others, _ = genicam(clock, off=-40.0)
    with_nodes(nodes, "LineSelector", "LineMode", "LineSource")
    queue, trigger = [], nodes.TriggerSoftware.execute
    others.TriggerSoftware.execute()  # so that there is a buffer; its stamp is the edge's
    fetch = second.fetch

    def both():
        trigger()
        queue.append(exposed[-1] + 2e-6)

    def edge(timeout):
        if not queue:
            raise TimeoutError("no buffer")
        buffer = fetch(timeout)
        buffer.timestamp_ns = int((queue.pop(0) + 40.0) * 1e9)
        return buffer

    nodes.TriggerSoftware.execute = both
    second.fetch, second.try_fetch = edge, lambda timeout: edge(timeout) if queue else None
    others.TriggerSoftware.execute = lambda: pytest.fail("nothing but the edge exposes it")
    sources = (
        GenicamSource("edge", second, clock, SIZE, CaptureSettings(trigger="Line1")),
        GenicamSource("main", first, clock, SIZE, CaptureSettings(strobe="Line2")),
    )
    return sources, nodes, others, exposed, queue


def test_a_strobe_exposes_another_camera_and_their_stamps_are_compared():
    clock = Ticking()
    sources, nodes, others, exposed, queue = wired(clock)
    assert others.TriggerSource.value == "Line1" and others.TriggerMode.value == "On"
    assert (nodes.LineSelector.value, nodes.LineMode.value, nodes.LineSource.value) == (
        "Line2",
        "Output",
        "ExposureActive",
    )
    assert [source.can_set_exposure for source in sources] == [False, True]
    queue.append(clock.now())  # an edge of long before: nobody waited for it
    differences = StampDifferences()
    cameras = SynchronisedCameras(sources, clock)
    for k in range(3):
        clock.sleep(1.0)
        for source in cameras.sources:
            if source.waits_for_edge:
                source.arm()
        frames = {"main": cameras.sources[1].grab(), "edge": cameras.sources[0].grab()}
        assert not queue and len(exposed) == k + 1
        for frame in frames.values():
            assert abs(frame.t - (exposed[-1] + 0.0025)) < 3 * frame.t_sigma < 0.1
        differences.add(frames)
    (line,) = differences.lines()
    assert line.startswith("edge exposed ") and "ms after main in the mean of 3 frames" in line
    with pytest.raises(
        CameraError, match="'edge' gave no image in 5 s after an edge at Line1: is a strobe wired to it"
    ):
        sources[0].grab()
    cameras.close()


def test_cameras_of_which_an_edge_exposes_one_are_armed_first_and_tried_again_together():
    calls = []

    class Edge:
        name, can_set_exposure, waits_for_edge = "edge", False, True

        def arm(self):
            calls.append("arm")

        def grab(self):
            while "trigger" not in calls[-2:]:
                time.sleep(1e-4)
            if calls.count("arm") < 2:
                raise CameraError("camera 'edge' gave no image")
            return Frame(np.zeros((2, 2), np.uint8), 1.0002, 1e-4)

        def close(self):
            calls.append("closed")

    class Main(Edge):
        name, waits_for_edge = "main", False

        def grab(self):
            calls.append("trigger")
            return Frame(np.zeros((2, 2), np.uint8), 1.0, 1e-4)

    cameras = SynchronisedCameras((Main(), Edge()), Ticking())
    frames = cameras.grab()
    assert calls == ["arm", "trigger", "arm", "trigger"] and set(frames) == {"main", "edge"}
    assert cameras.retried == [("main, edge", "camera 'edge' gave no image")]
    cameras.close()
    differences = StampDifferences()
    differences.add(frames)
    assert differences.lines() == [
        "edge exposed +0.200 ms after main in the mean of 1 frames, between +0.200 and +0.200; their clocks are "
        "compared to 0.141 ms (standard deviation)"
    ]


def test_the_wired_cameras_of_the_page_are_those_that_open(tmp_path):
    page = (ROOT / "docs" / "operating.md").read_text().split("\n## Wired cameras\n")[1].split("\n## ")[0]
    text = "".join(line[4:] for line in page.splitlines(True) if line.startswith("    "))
    settings = [CaptureSettings(**table["capture"]) for table in tomllib.loads(text)["camera"]]
    assert [(one.trigger, one.strobe, one.ptp) for one in settings] == [("", "Line2", True), ("Line1", "", True)]
    clock = Ticking()
    for one in settings:
        acquirer, nodes, _ = genicam(clock)
        with_nodes(nodes, "LineSelector", "LineMode", "LineSource", *PTP_NODES[0])
        nodes.PtpDataSetLatch.execute = lambda nodes=nodes: setattr(nodes.PtpStatus, "value", "Slave")
        assert GenicamSource("cam", acquirer, clock, SIZE, one).waits_for_edge == bool(one.trigger)


@pytest.mark.parametrize("names", PTP_NODES)
def test_cameras_that_keep_time_by_ptp_share_one_clock(names):
    clock, ptp = Ticking(), ClockOffset()

    def follows(acquirer, nodes, status="Slave"):
        with_nodes(nodes, *names)
        latched = iter(["Listening", "Uncalibrated", status])
        getattr(nodes, names[1]).execute = lambda: setattr(getattr(nodes, names[2]), "value", next(latched, status))
        return acquirer, nodes

    sources = []
    for k in range(2):
        acquirer, nodes = follows(*genicam(clock)[:2])
        sources.append(GenicamSource(f"cam{k}", acquirer, clock, SIZE, CaptureSettings(ptp=True), ptp=ptp))
        assert getattr(nodes, names[0]).value is True
    for _ in range(20):
        clock.sleep(0.1)
        frames = [source.grab() for source in sources]
    assert frames[0].t_sigma == pytest.approx(frames[1].t_sigma, abs=1e-4) and ptp.restarts == 0
    acquirer, nodes = follows(*genicam(clock, off=249.0)[:2])  # says that it follows, and is a second off
    other = GenicamSource("cam2", acquirer, clock, SIZE, CaptureSettings(ptp=True), ptp=ptp)
    with pytest.raises(CameraError, match="'cam2': its stamps contradict those of the other cameras"):
        other.grab()
    acquirer, nodes = follows(*genicam(clock)[:2], "Listening")
    with pytest.raises(CameraError, match=f"does not follow PTP within 30 s: its {names[2]} is Listening"):
        GenicamSource("cam3", acquirer, clock, SIZE, CaptureSettings(ptp=True), ptp=ptp)
    with pytest.raises(CameraError, match="it has no PtpEnable"):
        GenicamSource("cam4", genicam(clock)[0], clock, SIZE, CaptureSettings(ptp=True), ptp=ptp)


def test_a_genicam_camera_that_is_silent_or_packs_its_pixels_is_named():
    clock = Ticking()
    acquirer, _, _ = genicam(clock, "Mono12p")
    with pytest.raises(CameraError, match="Mono12p"):
        GenicamSource("cam0", acquirer, clock, SIZE).grab()
    acquirer.fetch = lambda timeout: None
    with pytest.raises(CameraError, match="gave no image in 5 s"):
        GenicamSource("cam0", acquirer, clock, SIZE).grab()


def png(value):
    return cv2.imencode(".png", np.full(SIZE[::-1], value, np.uint8))[1].tobytes()


def test_a_watched_folder_gives_whole_files_that_came_after_asking(tmp_path):
    clock = Ticking()
    (tmp_path / "old.png").write_bytes(png(1))
    source = FolderSource(camera(), tmp_path, clock)
    (tmp_path / "unasked.png").write_bytes(png(2))
    whole = png(7)
    clock.due = [
        (1000.5, lambda: (tmp_path / "new.png").write_bytes(whole[:40])),
        (1000.6, lambda: (tmp_path / "new.png").write_bytes(whole[:-5])),
        (1000.7, lambda: (tmp_path / "new.png").write_bytes(whole)),
    ]
    frame = source.grab()
    assert frame.image[0, 0] == 7 and 1000.7 <= clock.now() < 1000.8
    assert abs(frame.t - 1000.25) < 0.02 and frame.t_sigma == pytest.approx(0.5 / 12**0.5, abs=0.02)
    raw = cv2.imencode(".bmp", np.full(SIZE[::-1], 9, np.uint8))[1].tobytes()  # has no end mark: it must stop growing
    start = clock.now()
    clock.due = [
        (start + 0.1 * k, lambda k=k: (tmp_path / "b.bmp").write_bytes(raw[: len(raw) * k // 5])) for k in range(1, 6)
    ]
    assert source.grab().image[0, 0] == 9 and clock.now() >= start + 0.7
    with pytest.raises(CameraError, match="no whole image appeared"):
        source.grab()


def test_a_watched_folder_refuses_another_size(tmp_path):
    clock = Ticking()
    source = FolderSource(camera(), tmp_path, clock)
    clock.due = [
        (
            1000.1,
            lambda: (tmp_path / "a.png").write_bytes(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1].tobytes()),
        )
    ]
    with pytest.raises(CameraError, match="8 x 8 px, but rig.toml has 32 x 24"):
        source.grab()


def test_an_emulators_camera_needs_an_emulator():
    with pytest.raises(CameraError, match="rig emulate"):
        EmulatedSource("cam0", "127.0.0.1:1", Ticking(), SIZE)


def test_bayer_images_become_colour_ones_and_rgb_turns_round():
    clock = Ticking()
    acquirer, _, _ = genicam(clock, "BayerRG12")
    plain = acquirer.fetch

    def coloured(form, pixels):
        def fetch(timeout):
            buffer = plain(timeout)
            buffer.payload.components[0].data_format = form
            buffer.payload.components[0].data = pixels.copy()  # which the producer takes back
            return buffer

        acquirer.fetch = fetch
        return GenicamSource("cam0", acquirer, clock, SIZE).grab().image

    mosaic = np.zeros(SIZE[::-1], np.uint16)
    mosaic[::2, ::2] = 4000  # red alone
    image = coloured("BayerRG12", mosaic.ravel())
    assert image.dtype == np.uint16 and image.shape == (*SIZE[::-1], 3)
    assert (image[4, 4] == [0, 0, 64000]).all()
    np.testing.assert_array_equal(coloured("BayerBG12", mosaic.ravel())[4, 4], [64000, 0, 0])
    rgb = np.tile(np.array([1, 2, 3], np.uint8), SIZE[0] * SIZE[1])
    np.testing.assert_array_equal(coloured("RGB8", rgb)[0, 0], [3, 2, 1])


def test_genicam_settings_are_made_and_one_that_is_not_taken_is_named():
    clock = Ticking()
    acquirer, nodes, _ = genicam(clock)
    nodes.PixelFormat, nodes.Gain, nodes.GainAuto, nodes.BalanceWhiteAuto = Node(), Node(), Node("Continuous"), Node()
    GenicamSource("cam0", acquirer, clock, SIZE, CaptureSettings("BayerRG8", 3.0))
    assert (nodes.PixelFormat.value, nodes.Gain.value) == ("BayerRG8", 3.0)
    assert nodes.GainAuto.value == nodes.BalanceWhiteAuto.value == "Off"
    del nodes.Gain
    nodes.Gain = property  # its value cannot be set
    with pytest.raises(CameraError, match="'cam0' does not take Gain = 3"):
        GenicamSource("cam0", acquirer, clock, SIZE, CaptureSettings(gain=3.0))


def test_genicam_cameras_share_one_harvester_until_the_last_is_closed(monkeypatch):
    made = []

    class Harvester:
        def __init__(self):
            made.append(self)
            self.down = False
            self.device_info_list = [types.SimpleNamespace(serial_number=serial) for serial in ("A1", "B2")]

        def create(self, which):
            return genicam(Ticking())[0]

        def reset(self):
            self.down = True

    monkeypatch.setattr(
        genicam_harvester_interface_and_camera_discovery, "_harvester_of_producers", lambda name: Harvester()
    )
    one, two = (open_camera(camera(f"genicam:{serial}"), Ticking()) for serial in ("A1", "B2"))
    assert len(made) == 1
    with pytest.raises(CameraError, match="no GenICam camera 'C3'; there are 'A1', 'B2'"):
        open_camera(camera("genicam:C3"), Ticking())
    one.close()
    assert not made[0].down
    two.close()
    assert made[0].down
    open_camera(camera("genicam:A1"), Ticking()).close()
    assert len(made) == 2 and made[1].down


def test_a_camera_that_goes_while_it_is_opened_leaves_the_harvester_to_others(monkeypatch):
    class Gone:
        remote_device = property(lambda self: self.destroy())

        def destroy(self):
            raise RuntimeError("the device is gone")

    harvester = types.SimpleNamespace(
        device_info_list=[types.SimpleNamespace(serial_number="A1")], create=lambda which: Gone(), reset=lambda: None
    )
    made = []
    monkeypatch.setattr(
        genicam_harvester_interface_and_camera_discovery,
        "_harvester_of_producers",
        lambda name: made.append(name) or harvester,
    )
    for _ in range(2):
        with pytest.raises(CameraError, match="'cam0'.*the device is gone"):
            open_camera(camera("genicam:A1"), Ticking())
    assert len(made) == 2


class Raising:
    """A node, or a buffer, that raises genicam's errors."""

    def __init__(self, error):
        self.__dict__["error"] = error

    def __getattr__(self, name):
        raise self.error

    def __setattr__(self, name, value):
        raise self.error


def test_an_older_genicam_camera_without_stamps_in_nanoseconds_is_used():
    clock = Ticking()
    acquirer, nodes, exposed = genicam(clock)
    nodes.ExposureTimeAbs = nodes.ExposureTime
    del nodes.ExposureTime
    nodes.BalanceWhiteAuto = Raising(RuntimeError("AccessException"))  # as of grey images
    plain = acquirer.fetch

    class Ticks(contextlib.nullcontext):
        timestamp_frequency = 1.25e8

        @property
        def timestamp_ns(self):
            raise RuntimeError("NotImplementedException")

    def fetch(timeout):
        buffer, ticks = plain(timeout), Ticks()
        ticks.enter_result, ticks.payload, ticks.timestamp = ticks, buffer.payload, buffer.timestamp_ns / 8
        return ticks

    acquirer.fetch = fetch
    source = GenicamSource("cam0", acquirer, clock, SIZE)
    assert source.set_exposure(0.01) == 0.01
    for _ in range(4):
        clock.sleep(0.5)
        frame = source.grab()
        assert abs(frame.t - (exposed[-1] + 0.005)) <= 2 * frame.t_sigma < 0.04


def test_a_genicam_camera_that_fails_is_named_and_let_go_of():
    clock, released = Ticking(), []
    acquirer, nodes, _ = genicam(clock)
    source = GenicamSource("cam0", acquirer, clock, SIZE, let_go=lambda: released.append(1))
    plain = acquirer.fetch

    def short(timeout):
        buffer = plain(timeout)
        buffer.payload.components[0].data = np.zeros(7, np.uint16)
        return buffer

    acquirer.fetch = short
    with pytest.raises(CameraError, match="sent 7 of the 768 values of an image; are packets lost"):
        source.grab()
    nodes.TriggerSoftware = Raising(RuntimeError("Communication error"))
    with pytest.raises(CameraError, match="'cam0' does not answer; is it plugged in, and free.* Communication error"):
        source.grab()
    acquirer.stop = acquirer.destroy = lambda: nodes.TriggerSoftware.execute()
    source.close()
    assert released == [1]
    del nodes.ExposureTime
    with pytest.raises(CameraError, match="has no exposure time: none of ExposureTime, ExposureTimeAbs"):
        GenicamSource("cam0", acquirer, clock, SIZE)


def test_a_genicam_camera_that_two_producers_find_is_opened_by_the_one_that_can(monkeypatch):
    def create(place):
        if place == 0:
            raise ValueError("wrong subnet")
        return genicam(Ticking())[0]

    found = [types.SimpleNamespace(serial_number="A1")] * 2
    harvester = types.SimpleNamespace(device_info_list=found, create=create, reset=lambda: None)
    monkeypatch.setattr(
        genicam_harvester_interface_and_camera_discovery, "_harvester_of_producers", lambda name: harvester
    )
    open_camera(camera("genicam:A1"), Ticking()).close()
    del found[1:]
    with pytest.raises(CameraError, match="'A1' is there and cannot be opened; .* wrong subnet"):
        open_camera(camera("genicam:A1"), Ticking())


class Controls(Capture):
    """A capture whose controls hold what is set, but for those that are `stuck`."""

    def __init__(self, stuck=()):
        super().__init__(Ticking(), True)
        self.held, self.stuck = {}, stuck

    def set(self, key, value):
        if key not in self.stuck:
            self.held[key] = value
        return True

    def get(self, key):
        return self.held.get(key, 0.0)

    def isOpened(self):  # noqa: N802  (as cv2 has it)
        return True


def test_uvc_settings_are_made_and_one_that_is_not_taken_is_named(monkeypatch):
    settings = CaptureSettings("MJPG", 12.0, 30.0, 4600.0)
    stated = replace(camera("uvc:0"), capture=settings)
    capture = Controls()
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: capture)
    open_camera(stated, Ticking())
    held = capture.held
    assert held[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")
    assert list(held).index(cv2.CAP_PROP_FOURCC) < list(held).index(cv2.CAP_PROP_FRAME_WIDTH)
    assert (held[cv2.CAP_PROP_GAIN], held[cv2.CAP_PROP_FOCUS], held[cv2.CAP_PROP_WB_TEMPERATURE]) == (
        12.0,
        30.0,
        4600.0,
    )
    assert held[cv2.CAP_PROP_AUTOFOCUS] == held[cv2.CAP_PROP_AUTO_WB] == 0
    for control, name in (
        (cv2.CAP_PROP_FOURCC, "does not send MJPG"),
        (cv2.CAP_PROP_FOCUS, "does not take a focus of 30; it has 0"),
        (cv2.CAP_PROP_WB_TEMPERATURE, "does not take a white balance of 4600"),
    ):
        capture = Controls((control,))
        with pytest.raises(CameraError, match=name):
            open_camera(stated, Ticking())
        assert capture.released


@pytest.mark.parametrize(
    ("source", "settings", "says"),
    [
        ("uvc:0", 'pixel_format = "Mono12"', "is four letters, as MJPG"),
        ("genicam:A1", "focus = 3", "of source genicam takes pixel_format gain"),
        ("folder:/tmp", "gain = 3", "of source folder takes none"),
        ("uvc:0", "gian = 3", "gain"),
    ],
)
def test_settings_that_a_kind_of_camera_does_not_have_are_refused_in_rig_toml(tmp_path, source, settings, says):
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    path = tmp_path / "rig.toml"
    path.write_text(
        text.replace('shutter = "global"', f'shutter = "global"\nsource = "{source}"\ncapture = {{ {settings} }}')
    )
    with pytest.raises(FileError, match=says):
        design_from_rig_toml.load_design(path)
    path.write_text(text.replace('shutter = "global"', 'shutter = "global"\nsource = "uvc:0"\ncapture = { gain = 3 }'))
    assert design_from_rig_toml.load_design(path).cameras[0].capture == CaptureSettings(gain=3.0)
