"""Our own line protocol: conversations as pairs of bytes, its document, and the reference firmware at the far end of a
pseudo-terminal.
"""

import os
import re
import shutil
import subprocess
import tty
from dataclasses import replace

import numpy as np
import pytest

from rig.driving.axis_driver import Driver
from rig.driving.driving_clock import SimulatedClock, SystemClock
from rig.driving.protocols.native_strut_protocol import Struts
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.driving.serial_and_epics_ports_and_checksummed_frames import (
    SerialPort,
    encode_numbered_frame,
    last_valid_frame_in_line,
)
from rig.errors import ControllerFault, NoAnswer, PositionLost
from tests.conftest import ROOT
from tests.rig.scripted_wire import ScriptedPort

HELLO = [
    (b">1 HELLO*7DF0\n", encode_numbered_frame("<", 1, "OK struts/1 axes=6 boot=0EA93B36 line=128 pc")),
    (b">2 WATCH 1000*3DAA\n", b"<2 OK*27DA\n"),
]
STATE = "OK idle 1 0EA93B36 - 0 1000000 2000000 3000000 4000000 -5000000"


def talk(script, *what):
    """What the last of some dialogues comes to, after a hello, against a script that must be used up."""
    clock, protocol = SimulatedClock(), Struts(6, 1.0)
    port = ScriptedPort([*HELLO, *script], clock)
    link = Link(protocol, lambda: port, clock)
    link.connect(0)
    done = link.run(protocol.hello())
    for each in what:
        done = link.run(each(protocol))
    assert port.script == []
    return done


def test_the_document_s_conversation_is_what_is_sent():
    text = (ROOT / "docs" / "protocol.md").read_text()
    frames = re.findall(r"^    ([<>].*\*[0-9A-F]{4})$", text, re.MULTILINE)
    assert len(frames) == 14 and all(last_valid_frame_in_line(frame[0], frame) for frame in frames)
    target = np.full(6, 2e-3)
    pairs = [((frames[i] + "\n").encode(), (frames[i + 1] + "\n").encode()) for i in range(4, 14, 2)]
    assert [tuple(pair) for pair in HELLO] == [
        ((frames[i] + "\n").encode(), (frames[i + 1] + "\n").encode()) for i in (0, 2)
    ]
    segment = Segment(np.zeros(6), target, 0.2, target / 0.2, np.full(6, 0.2))
    state = talk(pairs, lambda p: p.home(1.0), lambda p: p.move(segment), lambda p: p.state())
    assert state.activity == "moving" and np.allclose(state.positions, 1.204e-3)


def test_state_and_fence():
    state = talk([(encode_numbered_frame(">", 3, "STATE"), encode_numbered_frame("<", 3, STATE))], lambda p: p.state())
    np.testing.assert_allclose(state.positions, [0, 1e-3, 2e-3, 3e-3, 4e-3, -5e-3], atol=1e-15)
    assert state.homed and state.fault == ""
    other = STATE.replace("0EA93B36", "0EA93B37")
    assert (
        talk([(encode_numbered_frame(">", 3, "STATE"), encode_numbered_frame("<", 3, other))], lambda p: p.fence())
        is False
    )


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        encode_numbered_frame("<", 2, STATE),
        encode_numbered_frame("<", 3, STATE)[:-9],
        encode_numbered_frame("<", 3, STATE).replace(b"1000000", b"1000001"),
        b"<- NAK*8B54\n",
        b"\xff" * 5000,
    ],
)
def test_an_answer_that_is_late_cut_altered_or_none_is_asked_for_again_under_a_new_number(answer):
    good = (
        encode_numbered_frame(">", 4, "STATE"),
        encode_numbered_frame("<", 3, STATE) + b"rubbish" + encode_numbered_frame("<", 4, STATE),
    )
    assert talk([(encode_numbered_frame(">", 3, "STATE"), answer), good], lambda p: p.state()).activity == "idle"


def test_a_silent_controller_is_named():
    with pytest.raises(NoAnswer, match="asked 4 times"):
        talk([(encode_numbered_frame(">", n, "STATE"), b"") for n in range(3, 7)], lambda p: p.state())


def test_a_move_is_sent_once_and_a_broken_arrival_is_no_verdict():
    segment = Segment(
        np.zeros(6), np.full(6, 1e-3), 0.1, np.full(6, 0.01), np.full(6, 0.01)
    )  # too short for full speed: a triangle
    sent = encode_numbered_frame(">", 3, "MOVE 0EA93B36 317 317" + " 1000000" * 6)
    assert talk([(sent, encode_numbered_frame("<", None, "NAK"))], lambda p: p.move(segment)).accepted is None
    refused = talk([(sent, encode_numbered_frame("<", 3, "ERR 6"))], lambda p: p.move(segment))
    assert refused.accepted is False and "started anew" in refused.reason


def test_a_controller_whose_lines_are_too_short_is_sent_no_move():
    clock, protocol = SimulatedClock(), Struts(6, 1.0)
    port = ScriptedPort(
        [(HELLO[0][0], encode_numbered_frame("<", 1, "OK struts/1 axes=6 boot=0EA93B36 line=64 pc")), HELLO[1]], clock
    )
    link = Link(protocol, lambda: port, clock)
    link.connect(0)
    link.run(protocol.hello())
    with pytest.raises(ControllerFault, match="lines of 64 bytes"):
        link.run(protocol.move(Segment(np.zeros(6), np.full(6, 0.1), 10.0, np.full(6, 0.01), None)))


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    """The reference firmware, compiled for this computer with every warning an error."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler; install gcc")
    program = tmp_path_factory.mktemp("firmware") / "struts"
    folder = ROOT / "firmware"
    subprocess.run(
        [
            compiler,
            "-std=c99",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-pedantic",
            "-D_POSIX_C_SOURCE=200809L",
            f"-I{folder / 'struts'}",
            str(folder / "pc" / "main.c"),
            str(folder / "struts" / "struts.c"),
            "-o",
            str(program),
        ],
        check=True,
    )
    return program


@pytest.fixture
def terminal(firmware):
    """The name of a pseudo-terminal with the firmware at its other end, its axes 0.4 mm from their switches."""
    master, slave = os.openpty()
    tty.setraw(slave)
    running = subprocess.Popen([firmware, *["400000"] * 6], stdin=master, stdout=master)
    yield os.ttyname(slave)
    running.terminate()
    running.wait()
    os.close(master)
    os.close(slave)


@pytest.fixture
def driven(driven_design, terminal):
    low = driven_design.mechanism.strut_range[:, 0]
    controller = replace(
        driven_design.controller,
        protocol="struts",
        port=terminal,
        zero=low - 1e-3,
        home=None,
        max_speed=np.full(6, 0.02),
        max_acceleration=np.full(6, 0.5),
    )
    return replace(driven_design, controller=controller)


def test_the_reference_firmware_homes_moves_and_stops(driven):
    home = driven.mechanism.strut_range[:, 0] - 1e-3
    with Driver(driven) as driver:
        with pytest.raises(PositionLost):
            driver.move(home + 1.5e-3)
        status = driver.home()
        np.testing.assert_allclose(status.lengths, home, atol=1e-9)
        arrived = driver.move(home + np.array([2, 2.2, 1.8, 1.5, 2, 1.2]) * 1e-3)
        np.testing.assert_allclose(arrived.lengths - home, np.array([2, 2.2, 1.8, 1.5, 2, 1.2]) * 1e-3, atol=1e-9)
        assert 0.1 < arrived.ended - arrived.start_time < 5
        assert driver.stop().activity == "idle" and driver.lengths() == pytest.approx(arrived.lengths)


def test_the_reference_firmware_stops_when_the_host_falls_silent(driven):
    clock, protocol = SystemClock(), Struts(6, 0.02)
    link = Link(protocol, lambda: SerialPort(driven.controller.port, 115200, clock), clock)
    link.connect(0)
    link.run(protocol.hello())
    assert link.run(protocol.home(20.0)).accepted
    assert link.run(
        protocol.move(Segment(np.zeros(6), np.full(6, 0.09), 3.0, np.full(6, 0.03), np.full(6, 3.0)))
    ).accepted
    clock.sleep(0.1)  # five times what it waits
    state = link.run(protocol.state())
    assert "received nothing" in state.fault and 0 < state.positions.max() < 0.02
    assert link.run(protocol.state()).positions == pytest.approx(state.positions)
    refused = link.run(protocol.move(Segment(np.zeros(6), np.full(6, 0.01), 1.0, np.full(6, 0.01), np.full(6, 3.0))))
    assert refused.accepted is False
    assert link.run(protocol.stop()).accepted and link.run(protocol.state()).fault == ""
    link.close()


def test_the_reference_firmware_carries_a_repeated_frame_out_once(terminal):
    port = SerialPort(terminal, 115200, clock := SystemClock())
    for frame in (encode_numbered_frame(">", 1, "HELLO"), *[encode_numbered_frame(">", 2, "HOME")] * 2):
        port.write(frame)
    text = b""
    while text.count(b"<2 OK") < 2:
        text += port.read(clock.now() + 5)
    assert b"ERR 5" not in text  # a second homing would have been refused as busy
    port.close()
