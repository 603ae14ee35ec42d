"""linuxcncrsh's conversations, as pairs of bytes; the answers are those of LinuxCNC 2.9 itself, with a simulated
machine.
"""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.driving.driving_clock import SimulatedClock
from rig.driving.protocols.linuxcnc import LinuxCNC
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.errors import ControllerFault
from tests.rig.scripted_wire import ScriptedPort

HOMED = (b"GET JOINT_HOMED\r\n", b"JOINT_HOMED YES YES YES YES YES YES\r\n")
POSITIONS = (b"GET JOINT_POS\r\n", b"JOINT_POS 475.851818 475.851818 475.851818 475.851818 475.851818 475.851818\r\n")


def hello(kind=b"4", units=b"MM"):
    return [
        (b"HELLO EMC rig 1.0\r\n", b"HELLO ACK EMCNETSVR 1.1\r\n"),
        (b"SET ECHO OFF\r\n", b"SET ECHO OFF\r\n"),
        (b"SET VERBOSE ON\r\n", b"SET VERBOSE ACK\n\r"),
        (b"SET ENABLE EMCTOO\r\n", b"SET ENABLE ACK\n\r"),
        (b"GET KINEMATICS_TYPE\r\n", b"KINEMATICS_TYPE " + kind + b"\r\n"),
        (b"GET USER_LINEAR_UNITS\r\n", b"USER_LINEAR_UNITS " + units + b"\r\n"),
        POSITIONS,
        HOMED,
    ]


def state(*errors, machine=b"ON", estop=b"OFF"):
    return [
        (b"GET PROGRAM_STATUS\r\n", b"PROGRAM_STATUS IDLE\r\n"),
        POSITIONS,
        *[(b"GET ERROR\r\n", b"ERROR " + error + b"\r\n") for error in errors],
        (b"GET ERROR\r\n", b"ERROR OK\r\n"),
        (b"GET MACHINE\r\n", b"MACHINE " + machine + b"\r\n"),
        (b"GET ESTOP\r\n", b"ESTOP " + estop + b"\r\n"),
        (b"GET JOINT_FAULT\r\n", b"JOINT_FAULT OK OK OK OK OK OK\r\n"),
        HOMED,
    ]


def talk(script, *what, kinematics="world"):
    """What the last of some dialogues comes to, against a script that must be used up."""
    clock, protocol = SimulatedClock(), LinuxCNC("XYZABC", kinematics, "EMC", "EMCTOO")
    port = ScriptedPort(script, clock)
    link = Link(protocol, lambda: port, clock)
    link.connect(0)
    done = None
    for each in what:
        done = link.run(each(protocol))
    assert port.script == []
    return done


def test_hello():
    assert talk(hello(), lambda p: p.hello()) == "LinuxCNC, EMCNETSVR 1.1, world mode"


def test_axis_words_that_are_no_struts_are_refused():
    with pytest.raises(ControllerFault, match='kinematics are of type 4 and .* is "joint"'):
        talk(hello()[:5], lambda p: p.hello(), kinematics="joint")
    assert "joint mode" in talk(hello(b"1"), lambda p: p.hello(), kinematics="joint")


def test_wrong_passwords_are_named():
    with pytest.raises(ControllerFault, match="\\[controller\\] password"):
        talk([(b"HELLO EMC rig 1.0\r\n", b"HELLO NAK\r\n")], lambda p: p.hello())
    with pytest.raises(ControllerFault, match="enable_password"):
        talk([*hello()[:3], (b"SET ENABLE EMCTOO\r\n", b"SET ENABLE NAK\n\r")], lambda p: p.hello())


def test_state_reads_every_error_that_waits():
    errors = [f"Linear move on line 0 would exceed joint {i}'s positive limit".encode() for i in range(6)]
    read = talk([*hello(), *state(*errors)], lambda p: p.hello(), lambda p: p.state())
    assert read.activity == "idle" and read.homed and read.fault.count("positive limit") == 6
    np.testing.assert_allclose(read.positions, 0.475851818)
    off = talk([*hello(), *state(machine=b"OFF", estop=b"ON")], lambda p: p.hello(), lambda p: p.state())
    assert off.activity == "off" and off.fault == "emergency stop"


def test_inches_are_told_as_inches():
    mode = (b"GET MODE\r\n", b"MODE MDI\r\n")
    line = b"SET MDI G20 G90 G93 G53 G1 X1.000000 Y1.000000 Z1.000000 A1.000000 B1.000000 C1.000000 F12.000000\r\n"
    segment = Segment(np.zeros(6), np.full(6, 0.0254), 5.0, np.full(6, 0.01), None)
    assert talk(
        [*hello(b"1", b"INCH"), mode, (line, b"SET MDI ACK\n\r")],
        lambda p: p.hello(),
        lambda p: p.move(segment),
        kinematics="joint",
    ).accepted


def test_a_pose_as_genhexkins_counts_it():
    modes = [(b"GET MODE\r\n", b"MODE MANUAL\r\n"), (b"SET MODE MDI\r\n", b"SET MODE ACK\n\r")]
    line = b"SET MDI G21 G90 G93 G53 G1 X10.000000 Y-20.000000 Z450.000000 A1.000000 B2.000000 C3.000000 F30.000000\r\n"
    turn = (
        Rotation.from_euler("z", 3, degrees=True)
        * Rotation.from_euler("y", 2, degrees=True)
        * Rotation.from_euler("x", 1, degrees=True)
    )
    segment = Segment(
        np.zeros(6), np.zeros(6), 2.0, np.zeros(6), None, RigidTransform.from_components([0.01, -0.02, 0.45], turn)
    )
    assert talk([*hello(), *modes, (line, b"SET MDI ACK\n\r")], lambda p: p.hello(), lambda p: p.move(segment)).accepted


def test_homing_joint_by_joint_where_all_at_once_is_unknown():
    begin = [
        (b"GET ESTOP\r\n", b"ESTOP OFF\r\n"),
        *[
            (f"SET {what}\r\n".encode(), f"SET {what.split()[0]} ACK\n\r".encode())
            for what in ("MACHINE ON", "MODE MANUAL", "TELEOP_ENABLE OFF")
        ],
        (b"GET ERROR\r\n", b"ERROR OK\r\n"),
    ]
    ones = [(f"SET HOME {i}\r\n".encode(), b"SET HOME ACK\n\r") for i in range(6)]
    script = [*begin, (b"SET HOME -1\r\n", b"SET HOME NAK\n\r"), *ones, (b"GET ERROR\r\n", b"ERROR OK\r\n"), HOMED]
    assert talk(script, lambda p: p.home(10.0)).accepted


def test_an_emergency_stop_is_never_taken_off_by_itself():
    verdict = talk([(b"GET ESTOP\r\n", b"ESTOP ON\r\n")], lambda p: p.home(10.0))
    assert verdict.accepted is False and "emergency stop" in verdict.reason


def test_a_server_that_started_anew_is_noticed_by_its_joints():
    greeting = hello()[0]
    second_conversation = [*hello(), greeting, (b"GET JOINT_HOMED\r\n", b"JOINT_HOMED NO NO NO NO NO NO\r\n")]
    assert talk(second_conversation, lambda p: p.hello(), lambda p: p.fence()) is False
