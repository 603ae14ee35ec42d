"""GCS 2.0's conversations, as pairs of bytes: what is sent, and what a PI controller answers."""

import numpy as np
import pytest

from rig.driving.driving_clock import SimulatedClock
from rig.driving.protocols.gcs import GCS
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.errors import ControllerFault, NoAnswer
from tests.rig.scripted_wire import ScriptedPort

IDENTITY = (b"*IDN?\n", b"(c)2015 Physik Instrumente (PI) GmbH & Co. KG, C-884.6DC, 117012345, 1.021\n")
AXES = "1 2 3 4 5 6"


def each(*values):
    """An answer of a line per axis: a blank before every line feed but the last."""
    return " \n".join(f"{axis}={value}" for axis, value in zip("123456", values)).encode() + b"\n"


def hello(servo=(1,) * 6, units=("MM",) * 6):
    return [
        IDENTITY,
        (b"SAI?\n", b"1 \n2 \n3 \n4 \n5 \n6\n"),
        (b"ERR?\n", b"0\n"),
        (b"PUN?\n", each(*units)),
        (f"SVO? {AXES}\n".encode(), each(*servo)),
    ]


def flags(on_target=(1,) * 6, servo=(1,) * 6, referenced=(1,) * 6):
    return [
        (f"{word} {AXES}\n".encode(), each(*values))
        for word, values in (("ONT?", on_target), ("SVO?", servo), ("FRF?", referenced))
    ]


def positions(*mm):
    return (f"POS? {AXES}\n".encode(), each(*(f"{value:.7f}" for value in mm)))


def talk(script, *what):
    """What the last of some dialogues comes to, after a hello where it begins with none, against a script that must be
    used up.
    """
    clock, protocol = SimulatedClock(), GCS((), 6)
    port = ScriptedPort(script, clock)
    link = Link(protocol, lambda: port, clock)
    link.connect(0)
    done = None
    for one in (lambda p: p.hello(), *what):
        done = link.run(one(protocol))
    assert port.script == []
    return done


def segment(target_mm):
    target = np.array(target_mm) / 1e3
    return Segment(np.zeros(6), target, 2.0, np.abs(target) / 2, None)


def test_hello_switches_servos_on_and_says_who_it_is():
    on = (b"SVO 1 1 2 1 3 1 4 1 5 1 6 1\nERR?\n", b"0\n")
    assert talk([*hello(servo=(1, 1, 0, 1, 1, 1)), on]).startswith("(c)2015 Physik Instrumente")
    with pytest.raises(ControllerFault, match="servos cannot be switched on: SVO: error -1024"):
        talk([*hello(servo=(0,) * 6), (on[0], b"-1024\n")])


def test_a_controller_with_fewer_axes_is_refused():
    with pytest.raises(ControllerFault, match="has the axes X Y"):
        talk([IDENTITY, (b"SAI?\n", b"X \nY\n")])


def test_names_of_axes_may_have_a_dash():
    names = [f"A-{i}" for i in range(6)]
    lines = [" \n".join(f"{name}{value}" for name in names).encode() + b"\n" for value in ("", "=MM", "=1")]
    script = [
        IDENTITY,
        (b"SAI?\n", lines[0]),
        (b"ERR?\n", b"0\n"),
        (b"PUN?\n", lines[1]),
        (f"SVO? {' '.join(names)}\n".encode(), lines[2]),
    ]
    assert talk(script).endswith("axes A-0 A-1 A-2 A-3 A-4 A-5")


def test_older_controllers_count_in_mm():
    script = [
        *hello()[:3],
        (b"PUN?\n", b""),
        IDENTITY,
        (b"ERR?\n", b"2\n"),
        hello()[4],
        (b"\x05", b"3F\n"),
        positions(1, 2, 3, 4, 5, 6),
        (b"ERR?\n", b"0\n"),
    ]
    state = talk(script, lambda p: p.state())
    assert state.activity == "moving"
    np.testing.assert_allclose(state.positions, np.arange(1, 7) / 1e3)


def test_micrometres_are_told_as_micrometres():
    moved = (
        (b"VEL 1 500.000000\nERR?\n", b"0\n"),
        (b"MOV 1 1000.000000 2 0.000000 3 0.000000 4 0.000000 5 0.000000 6 0.000000\nERR?\n", b"0\n"),
    )
    assert talk([*hello(units=("um",) * 6), *moved], lambda p: p.move(segment([1, 0, 0, 0, 0, 0]))).accepted
    with pytest.raises(ControllerFault, match="count in DEG MM"):
        talk(hello(units=("MM", "MM", "MM", "MM", "MM", "DEG"))[:4])


def test_speeds_are_such_that_all_arrive_together():
    speeds = b"VEL 1 0.500000 3 1.000000 6 0.250000\nERR?\n"
    move = b"MOV 1 1.000000 2 0.000000 3 -2.000000 4 0.000000 5 0.000000 6 0.500000\nERR?\n"
    assert talk([*hello(), (speeds, b"0\n"), (move, b"0\n")], lambda p: p.move(segment([1, 0, -2, 0, 0, 0.5]))).accepted
    refused = talk([*hello(), (speeds, b"0\n"), (move, b"7\n")], lambda p: p.move(segment([1, 0, -2, 0, 0, 0.5])))
    assert refused.accepted is False and "position out of limits" in refused.reason
    assert (
        talk([*hello(), (speeds, b"8\n")], lambda p: p.move(segment([1, 0, -2, 0, 0, 0.5]))).accepted is False
    )  # and no MOV


def test_a_lost_answer_to_a_move_is_no_verdict_and_the_line_is_brought_in_step():
    speeds, move = (
        b"VEL 1 0.500000\nERR?\n",
        b"MOV 1 1.000000 2 0.000000 3 0.000000 4 0.000000 5 0.000000 6 0.000000\nERR?\n",
    )
    script = [*hello(), (speeds, b"0\n"), (move, b""), (IDENTITY[0], b"0\n" + IDENTITY[1])]
    assert talk(script, lambda p: p.move(segment([1, 0, 0, 0, 0, 0]))).accepted is None


def test_not_on_target_is_still_moving_and_a_servo_off_is_a_fault():
    look = [(b"\x05", b"0\n"), positions(*[1] * 6), (b"ERR?\n", b"0\n")]
    assert talk([*hello(), *look, *flags(on_target=(1, 1, 1, 0, 1, 1))], lambda p: p.state()).activity == "moving"
    state = talk([*hello(), *look[:2], (b"ERR?\n", b"-1024\n"), *flags(servo=(1, 1, 1, 0, 1, 1))], lambda p: p.state())
    assert state.activity == "off" and "servo of 4 is off" in state.fault and "-1024" in state.fault


def test_an_answer_that_lacks_an_axis_is_asked_for_again():
    short = (positions(*[1] * 6)[0], each(*["1.0"] * 5))
    script = [*hello(), (b"\x05", b"3F\n"), short, IDENTITY, positions(*[1] * 6), (b"ERR?\n", b"0\n")]
    assert talk(script, lambda p: p.state()).positions == pytest.approx(np.full(6, 1e-3))


def test_a_question_that_the_controller_does_not_know_is_named():
    with pytest.raises(NoAnswer, match="error 2 \\(unknown command\\)"):
        talk([*hello(), *[(b"\x05", b""), IDENTITY] * 4, (b"ERR?\n", b"2\n")], lambda p: p.state())


def test_referencing_that_one_axis_fails_is_said():
    begin = [(f"FRF {AXES}\nERR?\n".encode(), b"0\n"), (b"\x05", b"0\n"), (b"ERR?\n", b"0\n")]
    verdict = talk([*hello(), *begin, flags(referenced=(1, 1, 0, 1, 1, 1))[2]], lambda p: p.home(10.0))
    assert verdict.accepted is False and verdict.reason == "not referenced: 3"
    assert talk([*hello(), *begin, flags()[2]], lambda p: p.home(10.0)).accepted


def test_stop_waits_for_rest_and_takes_its_error_away():
    assert talk(
        [*hello(), (b"HLT\n", b""), (b"\x05", b"3F\n"), (b"\x05", b"0\n"), (b"ERR?\n", b"10\n")], lambda p: p.stop()
    ).accepted


def test_blanks_that_only_unicode_knows_are_no_digits():
    assert talk([*hello()[:2], (b"ERR?\n", b"\x1e0\n"), *hello()[3:]]).startswith("(c)2015")
