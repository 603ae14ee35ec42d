"""EPICS motor records of a soft IOC in another process: moves, limits, stalls, stops, and an IOC that dies."""

import re
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from rig.driving.axis_driver import Driver
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.driving.serial_and_epics_ports_and_checksummed_frames import (
    ChannelAccessPort,
    encode_numbered_frame,
    last_valid_frame_in_line,
)
from rig.errors import ControllerFault, FileError, LinkLost, MissingLibrary, PositionLost, Stopped
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.cli import run
from tests.conftest import ROOT

pytest.importorskip("caproto", reason="EPICS takes the package caproto: pip install 'rig[epics]'")
STEP = np.array([3.0, -2.0, 2.5, 1.0, 2.0, -3.0]) * 1e-3  # m
MOTORS = [f"RIG:m{k}" for k in range(1, 7)]
CONTROLLER = """
[controller]
protocol = "epics"
port = "ca://127.0.0.1:{port}"
axes = {motors}
zero = {zero}
max_speed = 0.03
max_acceleration = 0.6
timeout = 5.0
"""


class SoftIoc:
    """The IOC, which can be killed and started anew at the same port. units : of its records"""

    def __init__(self, units=("mm",) * 6):
        self.units = units
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.start()

    def start(self, at=0.0):
        words = [sys.executable, "-m", "tests.soft_motor_ioc", str(self.port), str(at), *self.units]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT)
        assert self.process.stdout.readline() == "ready\n"

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def ask(self, text):
        """Words of an answer by a circuit of its own."""
        clock = SystemClock()
        port = ChannelAccessPort(f"ca://127.0.0.1:{self.port}", clock)
        port.write(encode_numbered_frame(">", 1, text))
        out, end = b"", clock.now() + 5
        while not out.endswith(b"\n") and clock.now() < end:
            out += port.read(end)
        port.close()
        return last_valid_frame_in_line("<", out.decode()).text.split()


@pytest.fixture(scope="module")
def ioc():
    made = SoftIoc()
    yield made
    made.kill()


@pytest.fixture
def path(ioc, tmp_path):
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
    (tmp_path / "rig.toml").write_text(text)
    zero = home_lengths(design_from_rig_toml.load_design(tmp_path / "rig.toml").mechanism).tolist()
    (tmp_path / "rig.toml").write_text(text + CONTROLLER.format(port=ioc.port, motors=MOTORS, zero=zero))
    return tmp_path / "rig.toml"


@pytest.fixture
def driver(path):
    with Driver(design_from_rig_toml.load_design(path)) as made:
        made.home()
        yield made


def home(driver):
    return home_lengths(driver.mechanism)


@pytest.mark.slow
def test_motors_start_and_arrive_together_and_read_back(path):
    reports = []
    path.write_text(path.read_text().replace("max_speed = 0.03", "max_speed = 0.005"))  # six are not read at one moment
    with Driver(design_from_rig_toml.load_design(path)) as driver:
        driver.home()
        arrived = driver.move(home(driver) + 4 * STEP, report=reports.append)
        limits, warnings, status = driver.limits(), driver.limit_warnings(), driver.status()
    np.testing.assert_allclose(arrived.lengths, home(driver) + 4 * STEP, atol=1e-9)
    shares = np.array([(report.lengths - home(driver)) / (4 * STEP) for report in reports])
    is_moving = shares[(shares.min(axis=1) > 0.2) & (shares.max(axis=1) < 0.8)]
    assert len(is_moving) and np.ptp(is_moving, axis=1).max() < 0.1, "the way is straight"
    np.testing.assert_allclose(limits.travel, np.tile([-0.06, 0.06], (6, 1)))
    assert np.allclose(limits.speed, 0.3) and not warnings
    assert status.activity == "idle" and status.fault == ""


def test_a_limit_of_one_motor_keeps_all_at_rest(ioc, driver):
    ioc.ask("PUT RIG:m3.HLM=2")
    try:
        with pytest.raises(ControllerFault, match=r"RIG:m3: 2.5 is outside LLM -60 .. HLM 2 \(in its EGU\)"):
            driver.move(home(driver) + STEP)
    finally:
        ioc.ask("PUT RIG:m3.HLM=60")
    np.testing.assert_allclose(driver.lengths(), home(driver), atol=1e-9)
    driver.move(home(driver) + STEP)


def test_a_record_that_may_not_be_written_is_named_and_nothing_moves(ioc, path):
    ioc.ask("PUT RIG:locked=3")
    try:
        with Driver(design_from_rig_toml.load_design(path)) as driver:
            driver.home()
            with pytest.raises(ControllerFault, match="no write access to RIG:m3.VAL"):
                driver.move(home(driver) + STEP)
            np.testing.assert_allclose(driver.lengths(), home(driver), atol=1e-9)
    finally:
        ioc.ask("PUT RIG:locked=0")


@pytest.mark.parametrize(("kind", "why"), [("stall", "RIG:m3 slips or stalls"), ("fault", "RIG:m3 has a problem")])
def test_a_motor_that_fails_stops_all(ioc, driver, kind, why):
    ioc.ask(f"PUT RIG:{kind}=3")
    with pytest.raises(ControllerFault, match=why):
        driver.move(home(driver) + 4 * STEP)
    stood = driver.lengths()
    time.sleep(0.1)
    np.testing.assert_allclose(driver.lengths(), stood, atol=1e-9)
    with pytest.raises(ControllerFault, match="not ready to move"):
        driver.move(home(driver))
    driver.home()
    driver.move(home(driver) + STEP)


def test_a_stop_from_another_thread_ends_the_move(ioc, driver):
    stopping = threading.Timer(0.2, driver.stop)
    stopping.start()
    with pytest.raises(Stopped):
        driver.move(home(driver) + 10 * STEP)
    stopping.join()
    share = (driver.lengths() - home(driver)) / (10 * STEP)
    assert (share > 0).all() and (share < 0.9).all()
    driver.move(home(driver))


def test_a_pause_in_the_records_is_reported(ioc, driver):
    ioc.ask("PUT RIG:m2.SPMG=1")
    assert driver.status().activity == "held"
    with pytest.raises(ControllerFault, match="not ready to move: held"):
        driver.move(home(driver) + STEP)
    driver.unlock()
    driver.move(home(driver) + STEP)


def test_commands_of_the_shell(ioc, path):
    run("home", path)
    run("jog", path, "--strut", "2", "--by", "1")
    assert "idle" in run("status", path).stdout
    run("stop", path)
    assert abs(float(ioc.ask("GET RIG:m2.RBV")[1]) - 1.0) < 1e-6


def test_an_ioc_that_dies_in_a_move_ends_it_and_nothing_is_believed_after(ioc, driver, path, monkeypatch):
    connect = Link.connect
    monkeypatch.setattr(Link, "connect", lambda self, patience: connect(self, min(patience, 0.2)))
    threading.Timer(0.2, ioc.process.kill).start()
    with pytest.raises(LinkLost) as error:
        driver.move(home(driver) + 10 * STEP)
    assert any("could not be stopped" in note for note in error.value.__notes__)
    ioc.kill()
    ioc.start(at=4.0)
    with Driver(design_from_rig_toml.load_design(path)) as later:
        with pytest.raises(PositionLost):
            later.move(home(later))
        later.home()
        later.move(home(later) + STEP)


def test_a_controller_without_names_of_records_is_refused(path):
    path.write_text(re.sub("^axes = .*$", "", path.read_text(), flags=re.MULTILINE))
    with pytest.raises(FileError, match="protocol epics takes .*axes: the names of 6 motor records"):
        design_from_rig_toml.load_design(path)


def test_what_is_no_motor_record_or_not_there_is_named(ioc, path):
    for name, why in (("RIG:stall", "the server has no RIG:stall.EGU"), ("RIG:m7", "the server has no RIG:m7.EGU")):
        text = path.read_text().replace("'RIG:m6'", f"'{name}'")
        path.write_text(text)
        made = Driver(design_from_rig_toml.load_design(path))
        with pytest.raises(ControllerFault, match=why):
            made.open()
        made.close()
        path.write_text(text.replace(f"'{name}'", "'RIG:m6'"))


def test_motors_are_stopped_though_the_record_of_another_is_missing(ioc, driver, path):
    path.write_text(path.read_text().replace("'RIG:m4'", "'RIG:gone'"))
    ioc.ask("PUT " + " ".join(f"{motor}.VELO=5" for motor in MOTORS))
    ioc.ask("PUT " + " ".join(f"{motor}.VAL=30" for motor in MOTORS))
    refused = run("stop", path, ok=False).stderr
    assert "the struts may still move: STOP: the server has no RIG:gone.STOP" in refused
    stopped = [motor for motor in MOTORS if motor != "RIG:m4"]
    time.sleep(0.3)  # their ramp
    stood = ioc.ask("GET " + " ".join(f"{motor}.RBV" for motor in stopped))
    time.sleep(0.1)
    assert ioc.ask("GET " + " ".join(f"{motor}.RBV" for motor in stopped)) == stood
    assert ioc.ask("GET RIG:m4.DMOV")[1] == "0.0", "the one that nobody named moves on"


def test_a_record_for_which_the_server_is_silent_does_not_keep_the_others_from_their_stop(ioc, monkeypatch):
    port = ChannelAccessPort(f"ca://127.0.0.1:{ioc.port}", SystemClock())
    send = port._send  # without the request to make that channel, for which nobody answers then
    monkeypatch.setattr(
        port, "_send", lambda *commands: send(*(c for c in commands if "RIG:x" not in str(getattr(c, "name", ""))))
    )
    ioc.ask("PUT RIG:m1.VELO=1 RIG:m2.VELO=1")
    ioc.ask("PUT RIG:m1.VAL=-30 RIG:m2.VAL=-30")
    writing = threading.Thread(
        target=port.write, args=(encode_numbered_frame(">", 1, "PUT RIG:x.STOP=1 RIG:m1.STOP=1"),)
    )
    writing.start()
    time.sleep(0.5)
    assert writing.is_alive() and ioc.ask("GET RIG:m1.DMOV RIG:m2.DMOV")[1:] == ["1.0", "0.0"]
    writing.join()
    answer = last_valid_frame_in_line("<", port.read(SystemClock().now()).decode()).text
    port.close()
    assert answer == "ERR no%20channel%20RIG%3Ax.STOP%20within%202%20s"
    ioc.ask("PUT RIG:m2.STOP=1")


def test_without_the_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "caproto", None)
    with pytest.raises(MissingLibrary, match=r"pip install 'rig\[epics\]'"):
        ChannelAccessPort("ca://127.0.0.1", SystemClock())
