"""Symétrie's command interface in conversation, as pairs of bytes: poses in mm and degrees for lengths, and back."""

from dataclasses import replace

import numpy as np
import pytest

from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import poses_of_xyz_mm_uvw_degrees
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.protocols.symetrie import STATUS, Symetrie
from rig.errors import ControllerFault
from rig.model.mechanisms import hexapod
from tests.rig import scripted_wire

READY = 0b1001110  # initialised, control on, in position, homed
POSE = [1.0, 2.0, -3.0, 3.0, -2.0, 5.0]
MOVE = "c_par(1)=1.000000 c_par(2)=2.000000 c_par(3)=-3.000000 c_par(4)=3.000000 c_par(5)=-2.000000 c_par(6)=5.000000"
SPEED, DONE = "c_cmd=C_CFG_SPEED", ("c_cmd", "0")


def lines(*pairs):
    """Pairs of bytes of requests and their answers, numbered; an answer "|" is the mark alone."""
    pairs = [("echo7", None), *pairs]
    script = []
    for k, (request, answer) in enumerate(pairs, 1):
        if answer is None:
            script.append((f"{request}\n".encode(), b"STDIN Open for ASCII Input\n\x06\n"))
            continue
        values = [] if answer == "|" else answer.split()
        text = answer if answer.startswith("stdin") else "\n".join([*values, str(k), "\x06"])
        script.append((f"c_par(19)={k} {request} c_par(19)\n".encode(), f"{text}\n".encode()))
    return script


def read(command, values):
    return [(command, "|"), DONE, (f"c_par(0),{len(values.split())},1", values)]


def status(bits=READY, pose=(0,) * 6, action=0, struts=(0,) * 6, errors=0):
    values = [bits, action, *pose, *pose, *struts]
    return (
        f"s_hexa,{STATUS},1",
        " ".join(f"{value:g}" for value in [*values, *[0] * (STATUS - 1 - len(values)), errors]),
    )


def fence(bits=READY):
    return [DONE, status(bits), *read("c_cfg=0 c_cmd=C_CFG_CS", "0 0 0 0 0 0 0 0 0 0 0 0")]


def hello(bits=READY):
    return [
        *read("c_cmd=C_VERSION", "1 5 0 22 222 5 1 22 222 7 42 1"),
        *read("c_cfg=0 c_cmd=C_CFG_SPEED", "1 1 0.01 0.001 4 5"),
        *read("c_cfg=0 c_cmd=C_CFG_TA", "0.2 0.1 5"),
        *fence(bits),
    ]


def talk(driven_design, pairs, what=None):
    design = replace(driven_design, controller=replace(driven_design.controller, zero=np.zeros(6)))
    protocol = Symetrie(design.controller, design.mechanism)
    return scripted_wire.talk(protocol, lines(*pairs), SimulatedClock(), what)


def a_move(mechanism, duration=2.0):
    target = hexapod.inverse(mechanism.home * poses_of_xyz_mm_uvw_degrees(POSE, "fixed"), mechanism)
    return Segment(hexapod.home_values(mechanism), target, duration, np.full(6, 0.004), np.full(6, 0.1))


def speeds(duration=2.0):
    turn = np.degrees(poses_of_xyz_mm_uvw_degrees(POSE, "fixed").rotation.magnitude())
    return f"c_cfg=1 c_par(0)={np.sqrt(14) / duration:.6f} c_par(1)={turn / duration:.6f} {SPEED}"


def turn(axis, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return R


def test_a_greeting_names_the_controller(driven_design):
    assert talk(driven_design, hello()) == "Symétrie hexapod 7-42, controller 5.0.22.222, interface 5.1.22.222"


def test_a_move_sets_both_speeds_and_the_time_of_the_ramp_and_commands_the_pose(driven_design):
    script = [
        *hello(),
        (speeds(), "|"),
        ("c_cmd", "5"),  # not yet taken up
        ("c_cmd", "1"),  # under way
        DONE,
        ("c_cfg=1 c_par(0)=0.100000 c_cmd=C_CFG_TA", "|"),  # 0.04 s, which is below its least
        DONE,
        status(),
        (f"c_par(0)=0 {MOVE} c_cmd=C_MOVE_PTP", "|"),
        DONE,
    ]
    assert talk(driven_design, script, lambda p: p.move(a_move(driven_design.mechanism))).accepted


def test_the_pose_read_back_turns_about_axes_that_stay(driven_design):
    pose = [1.0, -2.0, 3.0, 5.0, -6.0, 7.0]
    state = talk(driven_design, [*hello(), status(pose=pose)], lambda p: p.state())
    matrix = np.eye(4)
    matrix[:3, :3] = turn("z", 7) @ turn("y", -6) @ turn("x", 5)
    matrix[:3, 3] = [1e-3, -2e-3, 3e-3]
    T = driven_design.mechanism.home * type(driven_design.mechanism.home).from_matrix(matrix)
    np.testing.assert_allclose(state.positions, hexapod.inverse(T, driven_design.mechanism), atol=1e-12)


def test_a_refusal_has_its_reason(driven_design):
    begun = [*hello(), (speeds(), "|"), DONE, ("c_cfg=1 c_par(0)=0.100000 c_cmd=C_CFG_TA", "|"), DONE]
    move = f"c_par(0)=0 {MOVE} c_cmd=C_MOVE_PTP"
    segment = a_move(driven_design.mechanism)
    for rest, reason in (
        ([status(), (move, "|"), ("c_cmd", "-40")], "C_MOVE_PTP: code -40 (the pose is beyond its limits)"),
        ([status(), (move, "|"), ("c_cmd", "-13")], "C_MOVE_PTP: code -13 (parameter 3 is wrong)"),
        ([status(), (move, "stdin:1:1: error #20: ILLEGAL CMD: c")], "error #20: ILLEGAL CMD: c"),
        ([status(pose=[0.1, 0, 0, 0, 0, 0])], "it no longer stands where the move begins"),
    ):
        verdict = talk(driven_design, [*begun, *rest], lambda p: p.move(segment))
        assert (verdict.accepted, verdict.reason) == (False, reason)


@pytest.mark.parametrize("duration", [0.1, 1e4])
def test_speeds_beyond_the_controllers_are_refused_and_not_clipped(driven_design, duration):
    verdict = talk(driven_design, hello(), lambda p: p.move(a_move(driven_design.mechanism, duration)))
    assert verdict.accepted is False and "0.01 to 4 mm/s" in verdict.reason and "max_speed" in verdict.reason


def test_an_answer_to_an_older_request_is_passed_over(driven_design):
    script = lines(*hello(), ("s_hexa,45,1", ""))
    sent, _ = script[-1]
    old = status(bits=READY | 16)[1].split()
    new = status(pose=POSE)[1].split()
    number = str(len(script))
    script[-1] = (sent, "\n".join([*old, "3", "\x06", *new, number, "\x06", ""]).encode())
    design = replace(driven_design, controller=replace(driven_design.controller, zero=np.zeros(6)))
    protocol = Symetrie(design.controller, design.mechanism)
    assert scripted_wire.talk(protocol, script, SimulatedClock(), lambda p: p.state()).activity == "idle"


@pytest.mark.parametrize(
    "bits, action, activity, homed, fault",
    [
        (READY, 0, "idle", True, ""),
        (READY & ~4, 0, "off", True, ""),
        (READY & ~8, 0, "moving", True, ""),
        (READY | 16, 6, "moving", True, ""),
        (READY, 1, "moving", True, ""),
        (0b0101110, 4, "homing", False, ""),
        (0b0001010, 0, "idle", False, ""),
        (READY | 1, 0, "alarm", True, "1 error: strut 2 (following error)"),
        (READY | 17, 0, "moving", True, "1 error: strut 2 (following error)"),
        (READY | 1 << 14, 0, "alarm", True, "the emergency stop is pressed"),
        (0, 0, "alarm", False, "it is starting, which takes about two minutes"),
    ],
)
def test_what_the_bits_mean(driven_design, bits, action, activity, homed, fault):
    struts, errors = ((0, 1 << 12, 0, 0, 0, 0), 1) if bits & 1 else ((0,) * 6, 0)
    said = status(bits, action=action, struts=struts, errors=errors)
    state = talk(driven_design, [*hello(), said], lambda p: p.state())
    assert (state.activity, state.homed, state.fault) == (activity, homed, fault)


def test_a_coordinate_system_that_another_program_sets_stops_the_next_move(driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "symetrie", (), 1)
    driver.open()
    home = driver.home().lengths
    emulator.systems["Object"] = np.array([0, 0, 50.0, 0, 0, 0])
    with pytest.raises(ControllerFault, match="Object coordinate system, .* state tool in "):
        driver.move(home + 1e-3)
    assert not emulator.machine.executed


def test_motors_that_are_switched_off_at_rest_are_switched_on_by_unlocking(driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "symetrie", (), 1)
    driver.open()
    home = driver.home().lengths
    emulator._controlled = False
    with pytest.raises(ControllerFault, match="code -35|off"):
        driver.move(home + 1e-3)
    assert not emulator.machine.executed and driver.unlock().activity == "idle"
    driver.move(home + 1e-3)


@pytest.mark.parametrize("word", ["c_par(20)=1", "c_par(1)=a", "c_cmd=", "s_hexa,46,1", "gooble"])
def test_a_word_that_is_none_is_refused_by_the_emulator(driven_design, word):
    emulator = emulated_driver_with_emulator_and_clock(driven_design, "symetrie", (), 1)[1]
    assert emulator.answer(f"{word} c_par(19)").startswith("stdin:1:1: error #20")
