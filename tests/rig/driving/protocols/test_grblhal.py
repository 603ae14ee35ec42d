"""grblHAL's conversations, as pairs of bytes: what is sent, and what a controller answers."""

import numpy as np
import pytest

from rig.driving.driving_clock import SimulatedClock
from rig.driving.protocols.grblhal import GrblHAL
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.errors import ControllerFault, NoAnswer
from tests.rig.scripted_wire import ScriptedPort

IDLE = b"<Idle|MPos:1.000,2.000,3.000,4.000,5.000,6.000|Bf:100,1023|FS:0,0>\r\n"
BUILD = b"[VER:1.1f.20260817:]\r\n[OPT:VNML+,100,1024,6,0]\r\n[AXS:6:XYZABC]\r\nok\r\n"
MODES = (b"$G\n", b"[GC:G1 G54 G17 G21 G90 G94 G49 G98 G50 M5 M9 T0 F100 S0.]\r\nok\r\n")
HELLO = [
    (b"?", IDLE),
    (b"$I\n", BUILD),
    (b"$$\n", b"$10=511\r\n$13=0\r\n$376=7\r\nok\r\n"),
    MODES,
    (b"G21G90G94F100\n", b"ok\r\n"),
]


def talk(script, what, protocol=None):
    """What a dialogue comes to, against a script that must be used up."""
    clock = SimulatedClock()
    port = ScriptedPort(script, clock)
    protocol = protocol or GrblHAL("XYZABC")
    link = Link(protocol, lambda: port, clock)
    link.connect(0)
    done = link.run(what(protocol))
    assert port.script == []
    return done


def greeted(script=HELLO):
    protocol = GrblHAL("XYZABC")
    talk(script, lambda p: p.hello(), protocol)
    return protocol


def segment(target_mm, duration=2.0):
    target = np.array(target_mm) / 1e3
    return Segment(np.zeros(6), target, duration, np.abs(target) / duration, None)


def test_hello_learns_axes_and_buffer():
    assert talk(HELLO, lambda p: p.hello()) == "grblHAL 1.1f.20260817, axes XYZABC"


def test_a_controller_with_three_axes_is_refused_for_six():
    script = [HELLO[0], (b"$I\n", b"[VER:1.1f.20260817:]\r\n[OPT:VNML,35,1024,3,0]\r\n[AXS:3:XYZ]\r\nok\r\n")]
    with pytest.raises(ControllerFault, match="has the axes XYZ, not ABC"):
        talk(script, lambda p: p.hello())


def settled(*settings):
    return greeted([*HELLO[:2], (b"$$\n", b"".join(line + b"\r\n" for line in (*settings, b"ok"))), *HELLO[3:]])


@pytest.mark.parametrize(
    "settings, says",
    [
        ([b"$22=0"], "set $22=1, or state homing = false"),
        ([b"$22=0", b"$44=63"], "set $22=1"),
        ([b"$22=1", b"$44=4", b"$45=3", b"$46=0"], "leave out ABC"),
    ],
)
def test_homing_that_would_not_home_every_strut_is_refused_before_anything_is_sent(settings, says):
    script = [HELLO[0], HELLO[1], (b"$$\n", b"".join(line + b"\r\n" for line in (*settings, b"ok"))), *HELLO[3:]]
    homed = IDLE.replace(b"FS:0,0", b"FS:0,0|H:1")
    protocol = greeted([*script, (b"?", homed)] if b"$22=1" in settings else script)
    verdict = talk([], lambda p: p.home(10.0), protocol)
    assert verdict.accepted is False and says in verdict.reason
    assert b"$22=0" in settings or not talk([(b"?", homed)], lambda p: p.state(), protocol).homed


def test_rotary_axes_with_a_feed_of_their_own_are_refused():
    assert settled(b"$376=7", b"$680=0") is not None
    with pytest.raises(ControllerFault, match=r"takes ABC for rotary .* set \$376=0"):
        talk([*HELLO[:2], (b"$$\n", b"$376=7\r\n$680=1\r\nok\r\n")], lambda p: p.hello())


def test_state_in_machine_positions():
    state = talk([(b"?", IDLE)], lambda p: p.state())
    assert state.activity == "idle" and state.homed is None and state.fault == ""
    np.testing.assert_allclose(state.positions, np.arange(1, 7) / 1e3)


def test_state_in_work_positions_waits_for_their_offset():
    work = b"<Run|WPos:1.000,1.000,1.000,1.000,1.000,1.000|FS:0,0>\r\n"
    offset = b"<Run|WPos:1.000,1.000,1.000,1.000,1.000,1.000|WCO:0.500,0.000,0.000,0.000,0.000,-1.000>\r\n"
    state = talk([(b"?", work), (b"?", offset)], lambda p: p.state())
    np.testing.assert_allclose(state.positions, [1.5e-3, 1e-3, 1e-3, 1e-3, 1e-3, 0], atol=1e-12)


def test_reports_in_inches_leave_rotary_axes_alone():
    settings = (b"$$\n", b"$13=1\r\n$376=4\r\nok\r\n")  # the third of A, B, C turns
    protocol = greeted([*HELLO[:2], settings, *HELLO[3:]])
    state = talk(
        [(b"?", b"<Idle|MPos:0.1000,0.1000,0.1000,0.1000,0.1000,0.1000|FS:0,0>\r\n")], lambda p: p.state(), protocol
    )
    np.testing.assert_allclose(state.positions, [2.54e-3] * 5 + [0.1e-3], atol=1e-12)


def test_a_garbled_report_is_asked_for_again():
    script = [
        (b"?", b"<Idle|MPos:1.000,2.0"),
        (b"?", b"\xff\x00<Idle|MPos:1.000,2.000,3.000|FS:0,0>\r\n"),
        (b"?", IDLE),
    ]
    assert talk(script, lambda p: p.state()).activity == "idle"


def test_a_silent_controller_is_named():
    with pytest.raises(NoAnswer, match="asked 4 times"):
        talk([(b"?", b"")] * 4, lambda p: p.state())


def test_move_in_machine_coordinates_with_the_way_s_feed():
    line = b"G53G1X3.0000Y0.0000Z0.0000A0.0000B0.0000C-4.0000F150.0\n"  # 5 mm of way in 2 s
    assert talk([(line, b"ok\r\n")], lambda p: p.move(segment([3, 0, 0, 0, 0, -4])), greeted()).accepted is True


@pytest.mark.parametrize(
    "answer, accepted, reason",
    [
        (b"error:15\r\n", False, "error:15 (beyond the soft limits)"),
        (b"ALARM:2\r\n", False, "ALARM:2 (beyond the soft limits)"),
        (b"ok", None, "no answer to"),
        (b"[MSG:Caution]\r\n", None, "no answer to"),
    ],
)
def test_what_a_refusal_says(answer, accepted, reason):
    line = b"G53G1X3.0000Y0.0000Z0.0000A0.0000B0.0000C-4.0000F150.0\n"
    verdict = talk([(line, answer)], lambda p: p.move(segment([3, 0, 0, 0, 0, -4])), greeted())
    assert verdict.accepted is accepted and reason in verdict.reason


def test_a_small_receive_buffer_is_never_filled():
    small = (b"$I\n", b"[VER:1.1h.20190830:]\r\n[OPT:V,15,64]\r\n[AXS:6:XYZABC]\r\nok\r\n")
    sent = [(b"F12345.7\n", b"ok\r\n"), (b"G53G1X-312.346Y-312.346Z-312.346A-312.346B-312.346C-312.346\n", b"ok\r\n")]
    protocol = greeted([HELLO[0], small, *HELLO[2:]])
    target = np.full(6, -312.3456)
    assert talk(sent, lambda p: p.move(segment(target, np.linalg.norm(target) / 12345.67 * 60)), protocol).accepted
    assert max(len(line) for line, _ in sent) <= 63


def test_a_fence_takes_no_older_ok_and_notices_a_new_start():
    answer = b"[GC:G1 G54 G17 G21 G90 G94 G49 G98 G50 M5 M9 T0 F150 S0.]\r\nok\r\n"
    assert talk([(b"$G\n", b"ok\r\n" + answer)], lambda p: p.fence()) is True
    assert talk([(b"$G\n", answer.replace(b"F150", b"F0"))], lambda p: p.fence()) is False


@pytest.mark.parametrize(("slowing", "held"), [(b"Hold:1", b"Hold:0"), (b"Door:2", b"Door:1")])
def test_stop_lets_a_hold_end_before_it_resets(slowing, held):
    states = [IDLE.replace(b"Idle", word) for word in (slowing, held)]
    script = [
        (b"!", b""),
        *((b"?", state) for state in states),
        (b"\x18", b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"),
        (b"G21G90G94F100\n", b"ok\r\n"),
    ]
    assert talk(script, lambda p: p.stop(), greeted()).accepted


def test_stop_resets_what_answers_nothing_because_it_homes():
    banner = b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
    script = [
        (b"!", b""),
        (b"?", b""),
        (b"?", b""),
        (b"\x18", b"ALARM:6\r\n" + banner),
        (b"G21G90G94F100\n", b"error:9\r\n"),
    ]
    assert talk(script, lambda p: p.stop(), greeted()).accepted


@pytest.mark.parametrize("what, line", [("home", b"$H\n"), ("unlock", b"$X\n")])
def test_an_alarm_that_blocks_is_reset_before_it_is_homed_or_unlocked(what, line):
    """A limit switch's alarm: whoever asks for this at the machine has seen why."""
    script = [
        (line, b"error:79\r\n"),
        (b"\x18", b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"),
        (b"G21G90G94F100\n", b"ALARM:11\r\n[MSG:Homing cycle required]\r\nerror:9\r\n"),  # not of what follows
        (line, b"ok\r\n"),
        (b"G21G90G94F100\n", b"ok\r\n"),
    ]
    wanted = {"home": lambda p: p.home(10.0), "unlock": lambda p: p.unlock()}
    assert talk(script, wanted[what], greeted()).accepted


def test_scaled_coordinates_are_made_whole_again_and_never_moved_in():
    scaled = (MODES[0], MODES[1].replace(b"G50", b"G51:XY"))
    assert greeted([*HELLO[:3], scaled, HELLO[4], (b"G50\n", b"ok\r\n")]) is not None
    assert talk([MODES], lambda p: p.fence()) and not talk([scaled], lambda p: p.fence())


@pytest.mark.parametrize("state", [b"Hold:0", b"Door:1", b"Tool"])
def test_a_controller_that_is_held_is_said_to_be(state):
    with pytest.raises(ControllerFault, match=f"is in hold.*{state.decode()}.* rig stop"):
        talk([(b"?", IDLE.replace(b"Idle", state))], lambda p: p.hello())


def test_a_controller_that_still_moves_is_waited_for():
    assert greeted([HELLO[0], (b"$I\n", b"error:8\r\n"), *HELLO[1:]]) is not None


@pytest.mark.parametrize(
    "state, says", [(b"Check", "rig stop ends that"), (b"Sleep", "rig stop wakes it"), (b"Door:0", "door")]
)
def test_a_state_in_which_nothing_moves_is_told_with_its_way_out(state, says):
    read = talk([(b"?", IDLE.replace(b"Idle", state))], lambda p: p.state())
    assert says in read.fault and read.activity != "idle"


def test_events_are_found_in_merged_lines():
    protocol = GrblHAL("XYZABC")
    assert protocol.event("<Idle|MPos:0.0ALARM:1") == "ALARM:1 (a limit switch was hit, position lost)"
    assert protocol.event("Grbl 1.1h ['$' for help]") == "restarted" and protocol.event("ok") == ""
