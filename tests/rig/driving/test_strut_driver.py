"""The driver against emulators of every protocol: what it refuses, what it recovers, what it stops at, and that nothing
runs twice.
"""

from dataclasses import replace

import numpy as np
import pytest

from rig.driving.axis_driver import Driver
from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import ALWAYS, KINDS
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.driving.emulators.move_trials_through_emulator_with_faults import (
    emulated_driver_with_emulator_and_clock,
    run_moves_with_faults_and_count_outcomes,
)
from rig.driving.emulators.protocol_conformance_checks_against_emulator import ON_RESETS
from rig.errors import ControllerFault, MotionError, PositionLost, RigError, Stalled, Unreachable
from tests.rig.driver_steps import STEP, order, truly

RECOVERED = (
    "lost-ok",
    "two-ok",
    "resend",
    "resend-moving",
    "late",
    "half-line",
    "garbage",
    "early-stop",
    "unplug",
    "buffer-128",
)
STOPPED = {
    "runs-after-error": ControllerFault,
    "reset-ignored": ControllerFault,
    "done-in-error": ControllerFault,
    "stall": Stalled,
    "restart": (PositionLost, ControllerFault),
}
OTHERWISE = ("ok-after-error", "stale-alarm", "homes-on", "drift", "buffer-64")
WITHOUT_RESETS = (
    "struts",
    "hxp",
    "symetrie",
    "epics",
    "epics-hexapod",
)  # they report no alarm by themselves: it is read, with its request's number


def test_every_kind_of_fault_is_tried_here():
    assert {*RECOVERED, *STOPPED, *OTHERWISE} == {*KINDS}


def test_homes_and_moves(ready):
    driver, emulator, clock, home = ready
    arrived = driver.move(home + STEP)
    np.testing.assert_allclose(arrived.lengths, home + STEP, atol=1e-6)
    np.testing.assert_allclose(truly(emulator, clock), home + STEP, atol=1e-6)
    assert arrived.note == "" and len(emulator.machine.executed) == 1 and 0.1 < arrived.ended - arrived.start_time < 1
    slow = driver.move(home, share=0.1)
    assert slow.ended - slow.start_time > 0.99


def test_struts_start_and_arrive_together_at_no_more_than_their_speeds(ready):
    driver, emulator, clock, home = ready
    begun = clock.now()
    driver.move(home + 4 * STEP)
    t, lengths = emulator.path(begun)
    share = (lengths - home) / (4 * STEP)
    np.testing.assert_allclose(share, np.broadcast_to(share[:, :1], share.shape), atol=1e-3)
    speed = np.abs(np.diff(lengths, axis=0)) / np.diff(t)[:, None]
    assert (
        speed.max(axis=0) <= driver.controller.max_speed * 1.001
    ).all() and speed.max() > 0.9 * driver.controller.max_speed.max()


@pytest.mark.parametrize("kind", [kind for kind in RECOVERED if kind not in ALWAYS])
def test_faults_that_are_recovered_from(ready, kind):
    driver, emulator, clock, home = ready
    order(emulator, kind)
    driver.move(home + STEP)
    assert kind in emulator.faults.struck and len(emulator.machine.executed) == 1
    np.testing.assert_allclose(truly(emulator, clock), home + STEP, atol=2e-6)
    driver.move(home)
    assert len(emulator.machine.executed) == 2


@pytest.mark.parametrize("kind", STOPPED)
def test_faults_that_a_move_is_stopped_for(ready, kind):
    driver, emulator, clock, home = ready
    order(emulator, kind)
    with pytest.raises(STOPPED[kind]):
        driver.move(home + 4 * STEP)
    stood = truly(emulator, clock)
    clock.sleep(10)
    np.testing.assert_allclose(truly(emulator, clock), stood, atol=1e-9)
    assert len(emulator.machine.executed) == 1


def test_an_error_is_believed_whatever_is_acknowledged_after_it(ready):
    driver, emulator, clock, home = ready
    order(emulator, "ok-after-error")
    try:
        driver.move(home + STEP)
        assert (
            len(emulator.machine.executed) == 1
        )  # a frame that came broken is sent again, once it is seen that nothing moved
    except ControllerFault as error:
        assert "refused" in str(error) and not emulator.machine.executed
    driver.move(home + STEP / 2)
    assert len(emulator.machine.executed) <= 2


def test_a_zero_that_wanders_is_noticed_before_the_next_move(ready):
    driver, emulator, clock, home = ready
    order(emulator, "drift")
    driver.move(home + STEP)
    clock.sleep(1)
    with pytest.raises(PositionLost, match="left at"):
        driver.move(home)
    assert len(emulator.machine.executed) == 1
    driver.home()
    driver.move(home + STEP)


@pytest.mark.parametrize("size", [64, 128])
def test_a_small_receive_buffer_makes_no_other_move(driven_design, protocol, size):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, protocol, (f"buffer-{size}",), 1)
    home = home_lengths(driven_design.mechanism)
    target = home + 8.123456e-3 * STEP / 1e-3
    driver.open()
    driver.home()
    try:
        driver.move(target)
    except MotionError:
        assert not emulator.machine.executed
    for one in emulator.machine.executed:
        np.testing.assert_allclose(one.target, target, atol=1e-6)


def test_a_stale_piece_before_an_alarm_after_a_reset_does_not_hide_it(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1)
    driver.open()
    driver.home()
    order(emulator, "stale-alarm", "stall")
    with pytest.raises(Stalled):
        driver.move(home_lengths(driven_design.mechanism) + STEP)
    assert driver.status().activity == "alarm" and not driver.status().known
    assert any("ALARM:3" in text for _, text in driver.link.events)


def test_nothing_is_sent_for_what_may_not_be_done(ready):
    driver, emulator, clock, home = ready
    low = driver.mechanism.strut_range[:, 0]
    with pytest.raises(Unreachable, match="strut 2"):
        driver.move(np.where(np.arange(6) == 1, low - 1e-3, home))
    with pytest.raises(ValueError, match="finite"):
        driver.move(np.full(6, np.nan))
    with pytest.raises(ValueError, match="share"):
        driver.move(home, share=0)
    driver.controller = replace(driver.controller, max_step=1e-4)
    with pytest.raises(Unreachable, match="step is too large"):
        driver.move(home + STEP)
    driver.controller = replace(driver.controller, max_step=None, margin=1.0)
    with pytest.raises(Unreachable, match="singularity"):
        driver.move(home + 8 * STEP)
    assert not emulator.machine.executed and np.allclose(truly(emulator, clock), home, atol=1e-9)


def test_a_rig_that_was_not_homed_is_not_moved(driven_design, protocol):
    if protocol == "urscript":
        pytest.skip("its encoders are absolute: it needs no homing to know its position")
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, protocol, (), 1)
    assert not driver.open().known
    with pytest.raises(MotionError):
        driver.move(home_lengths(driven_design.mechanism))
    assert not emulator.machine.executed


def test_a_rig_without_homing_is_believed_within_its_range(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1, homing=False)
    assert driver.open().known
    with pytest.raises(ControllerFault, match="homing = false"):
        driver.home()
    driver.trust()
    driver.move(home_lengths(driven_design.mechanism) + STEP)
    assert len(emulator.machine.executed) == 1


def test_a_position_in_alarm_is_not_believed_though_nothing_can_home(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1, homing=False)
    emulator.alarm = 3
    assert not driver.open().known
    with pytest.raises(
        ControllerFault, match="alarm .* --unlock"
    ):  # and not first that its position is lost, which nothing mends in an alarm
        driver.move(home_lengths(driven_design.mechanism))
    driver.unlock()
    with pytest.raises(PositionLost, match="--trust"):
        driver.move(home_lengths(driven_design.mechanism))
    assert not emulator.machine.executed


def test_poses_for_a_controller_with_its_own_kinematics(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(
        driven_design, "linuxcnc", (), 1, kinematics="world"
    )
    driver.open()
    driver.home()
    home = home_lengths(driven_design.mechanism)
    driver.move(home + 8 * STEP)
    np.testing.assert_allclose(truly(emulator, clock), home + 8 * STEP, atol=1e-7)


def test_a_rig_without_a_controller_cannot_be_driven(design):
    with pytest.raises(RigError, match="no \\[controller\\]"):
        Driver(design, SimulatedClock())


@pytest.mark.slow
def test_many_moves_with_every_fault_among_them(driven_design, protocol):
    verdicts = run_moves_with_faults_and_count_outcomes(driven_design, protocol, ["all:0.6"], 40, seed=3)
    assert len(verdicts.struck) >= 10 and verdicts.done > 15
    assert (verdicts.twice, verdicts.unacknowledged, verdicts.hangs, verdicts.reasonless, verdicts.unsafe) == (
        0,
        0,
        0,
        0,
        0,
    ), verdicts


@pytest.mark.slow
@pytest.mark.parametrize("buffer", [[], ["buffer-128"]], ids=["", "buffer-128"])
def test_ten_thousand_moves_with_faults_at_one_in_twenty(driven_design, protocol, buffer):
    seldom = (
        {"homes-on:0.05", "stale-alarm:0.3"} if protocol == "grblhal" else {"homes-on:0.05"}
    )  # homing and resets are far fewer than moves
    verdicts = run_moves_with_faults_and_count_outcomes(
        driven_design,
        protocol,
        ["all:0.05", *sorted(seldom), *buffer],
        10_000,
        seed=4,
        max_speed=np.full(6, 0.1),
        max_acceleration=np.full(6, 5.0),
    )
    never = {*KINDS} - {*verdicts.struck, *ALWAYS}
    without_resets = protocol in WITHOUT_RESETS or protocol.startswith("file:")
    assert never <= ({*ON_RESETS} if without_resets else set()) and verdicts.done > 9_000, never
    assert (verdicts.twice, verdicts.unacknowledged, verdicts.hangs, verdicts.reasonless, verdicts.unsafe) == (
        0,
        0,
        0,
        0,
        0,
    ), verdicts


def booted_locked(driven_design):
    """(driver, emulator, clock) of a grblHAL that starts in alarm until it is homed ($22=5)."""
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1)
    emulator.settings[22] = 5
    emulator.power_cycle()
    return driver, emulator, clock


def test_a_controller_that_starts_locked_moves_once_it_is_homed(driven_design):
    driver, emulator, clock = booted_locked(driven_design)
    status = driver.open()
    assert status.activity == "alarm" and status.homing_required and "homing is required" in status.fault
    with pytest.raises(ControllerFault, match="homed first"):
        driver.unlock()
    driver.home()
    driver.close()
    driver.open()  # as the next command does
    home = home_lengths(driven_design.mechanism)
    driver.move(home + STEP)
    np.testing.assert_allclose(truly(emulator, clock), home + STEP, atol=1e-6)


def test_a_controller_unlocked_after_it_started_in_alarm_moves_once_it_is_trusted(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1, homing=False)
    emulator.alarm = 3
    driver.open()
    driver.unlock()
    driver.trust()
    driver.move(home_lengths(driven_design.mechanism) + STEP)
    assert len(emulator.machine.executed) == 1


def test_a_start_since_the_last_contact_is_seen_until_the_position_is_confirmed(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1, homing=False)
    for _ in range(2):  # the first session's greeting does not hide it from the second
        driver.open()
        assert driver.started_anew
        driver.close()
    driver.open()
    driver.trust()
    assert not driver.started_anew
    driver.close()
    driver.open()
    assert not driver.started_anew
    emulator.power_cycle()
    driver.close()
    driver.open()
    assert driver.started_anew
