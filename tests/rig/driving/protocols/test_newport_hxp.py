"""Newport's HXP in conversation, as pairs of bytes: poses in mm and degrees for lengths, and back."""

from dataclasses import replace

import numpy as np
import pytest

from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import (
    poses_of_xyz_mm_uvw_degrees,
    xyz_mm_uvw_degrees_of_poses,
)
from rig.driving.protocols.newport_hxp import HXP
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.errors import ControllerFault
from rig.model.mechanisms import hexapod
from tests.rig import scripted_wire

SIX = ",".join(["double *"] * 6)
ZERO = ",".join(["0.000000"] * 6)
STATE = "GroupStatusGet(HEXAPOD,int *)"


def lines(*pairs, start=1):
    """Pairs of bytes of calls and their answers, numbered."""
    return [
        (f"{k} {call}\n".encode(), b"".join(f"{k} {one},EndOfAPI\n".encode() for one in answer.split("|") if one))
        for k, (call, answer) in enumerate(pairs, start)
    ]


def hello(position="0," + ZERO, state=11):
    return [
        ("FirmwareVersionGet(char *)", "0,HXP-D V1.0"),
        (f"HexapodPositionCurrentGet(HEXAPOD,{SIX})", position),
        *((f"HexapodCoordinateSystemGet(HEXAPOD,{name},{SIX})", f"0,{ZERO}") for name in ("Work", "Tool")),
        (STATE, f"0,{state}"),
        (f"HexapodPositionCurrentGet(HEXAPOD,{SIX})", position),
    ]


def talk(driven_design, pairs, what=None):
    design = replace(driven_design, controller=replace(driven_design.controller, zero=np.zeros(6)))
    clock, protocol = SimulatedClock(), HXP(design.controller, design.mechanism)
    return scripted_wire.talk(protocol, lines(*pairs), clock, what)


def turn(axis, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return R


def test_u_v_w_turn_about_axes_that_move_along_both_ways():
    values = np.array([1.0, -2.0, 3.0, 20.0, -30.0, 40.0])
    T = poses_of_xyz_mm_uvw_degrees(values)
    np.testing.assert_allclose(T.rotation.as_matrix(), turn("x", 20) @ turn("y", -30) @ turn("z", 40), atol=1e-15)
    np.testing.assert_allclose(T.translation, [1e-3, -2e-3, 3e-3], atol=1e-18)
    np.testing.assert_allclose(xyz_mm_uvw_degrees_of_poses(T), values, atol=1e-9)


def test_a_move_sets_the_speeds_of_the_struts_and_is_on_its_way_before_it_is_answered(driven_design):
    home = hexapod.home_values(driven_design.mechanism)
    T = driven_design.mechanism.home * poses_of_xyz_mm_uvw_degrees([1.0, 2.0, -3.0, 3.0, -2.0, 5.0])
    target = hexapod.inverse(T, driven_design.mechanism)
    segment = Segment(home, target, 2.0, np.r_[0.004, np.zeros(5)], np.full(6, 0.1))
    profile = ",".join(["double *"] * 4)
    script = [
        *hello(),
        (f"PositionerSGammaParametersGet(HEXAPOD.1,{profile})", "0,10,100,0.005,0.05"),
        ("PositionerSGammaParametersSet(HEXAPOD.1,4,100,0.005,0.05)", "0,"),
        ("HexapodMoveAbsolute(HEXAPOD,Work,1.000000,2.000000,-3.000000,3.000000,-2.000000,5.000000)", ""),
        (STATE, "0,44"),
    ]
    assert talk(driven_design, script, lambda p: p.move(segment)).accepted
    read = [*hello(), (STATE, "0,12"), (f"HexapodPositionCurrentGet(HEXAPOD,{SIX})", "0,1,2,-3,3,-2,5")]
    state = talk(driven_design, read, lambda p: p.state())
    np.testing.assert_allclose(state.positions, target, atol=1e-12)
    assert state.activity == "idle" and state.homed and state.fault == ""


def test_a_refusal_is_in_the_controllers_words(driven_design):
    home = hexapod.home_values(driven_design.mechanism)
    T = driven_design.mechanism.home * poses_of_xyz_mm_uvw_degrees([1.0, 2.0, -3.0, 3.0, -2.0, 5.0])
    script = [
        *hello(),
        ("HexapodMoveAbsolute(HEXAPOD,Work,1.000000,2.000000,-3.000000,3.000000,-2.000000,5.000000)", "-17,"),
        ("ErrorStringGet(-17,char *)", "0,Parameter out of range"),
    ]
    segment = Segment(home, hexapod.inverse(T, driven_design.mechanism), 1.0, np.zeros(6), None)
    verdict = talk(driven_design, script, lambda p: p.move(segment))
    assert verdict.accepted is False
    assert verdict.reason == "HexapodMoveAbsolute: error -17 (Parameter out of range)"


def test_firmware_before_xps_d_is_asked_by_the_groups_function(driven_design):
    older = hello()
    older[1] = (older[1][0], "-4,")
    older.insert(2, (f"GroupPositionCurrentGet(HEXAPOD,{SIX})", f"0,{ZERO}"))
    older[-1] = (f"GroupPositionCurrentGet(HEXAPOD,{SIX})", f"0,{ZERO}")
    assert talk(driven_design, older) == "Newport HXP-D V1.0, group HEXAPOD"


@pytest.mark.parametrize(
    "code, activity, homed, faulty, homing_required",
    [
        (0, "alarm", False, False, True),
        (5, "alarm", False, True, False),
        (11, "idle", True, False, False),
        (20, "off", True, False, False),
        (22, "off", True, True, False),
        (40, "alarm", False, True, False),
        (42, "alarm", False, False, True),
        (43, "homing", False, False, False),
        (44, "moving", True, False, False),
        (106, "alarm", False, True, False),
    ],
)
def test_what_the_states_of_the_group_mean(driven_design, code, activity, homed, faulty, homing_required):
    text = [(f"GroupStatusStringGet({code},char *)", "0,in words")] * faulty
    script = [*hello(), (STATE, f"0,{code}"), (f"HexapodPositionCurrentGet(HEXAPOD,{SIX})", f"0,{ZERO}"), *text]
    state = talk(driven_design, script, lambda p: p.state())
    assert (state.activity, state.homed, state.homing_required) == (activity, homed, homing_required)
    assert ("in words" in state.fault) == faulty


def test_a_coordinate_system_that_another_program_sets_stops_the_next_move(driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "hxp", (), 1)
    driver.open()
    home = driver.home().lengths
    emulator.systems["Tool"] = np.array([0, 0, 50.0, 0, 0, 0])
    with pytest.raises(ControllerFault, match="Tool coordinate system, .* state tool in "):
        driver.move(home + 1e-3)
    assert not emulator.machine.executed


def test_the_struts_travel_and_speed_are_compared_with_those_of_rig_toml(driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "hxp", (), 1)
    driver.open()
    assert driver.limit_warnings() == []
    emulator.limits = emulator.limits.copy()
    emulator.limits[2, 1] -= 5e-3
    (warning,) = driver.limit_warnings()
    assert warning.startswith("strut 3: the controller travels") and "user travel limits" in warning


@pytest.mark.parametrize(
    "call",
    [
        "GroupStatusStringGet(,char *)",
        "HexapodCoordinateSystemGet(HEXAPOD)",
        "PositionerSGammaParametersGet(HEXAPOD.7,double *)",
        "PositionerSGammaParametersSet(HEXAPOD.0,1,1,1,1)",
    ],
)
def test_a_call_with_wrong_words_is_refused_by_the_emulator(driven_design, call):
    emulator = emulated_driver_with_emulator_and_clock(driven_design, "hxp", (), 1)[1]
    assert emulator.answer(f"7 {call}").startswith("7 -17,")


def test_the_answer_to_the_urgent_stop_is_no_motions_end(driven_design):
    protocol = HXP(driven_design.controller, driven_design.mechanism)
    assert protocol.event("0 -22,GroupMoveAbort(HEXAPOD),EndOfAPI") == ""
