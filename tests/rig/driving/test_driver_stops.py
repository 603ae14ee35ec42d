"""The driver stops what moves: interrupted, asked by another thread or process, at a homing that fails, at a line that
is cut.
"""

import threading
from dataclasses import replace

import numpy as np
import pytest

from rig.driving.axis_driver import Driver
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import EmulatorPort, home_lengths
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.errors import ControllerFault, LinkLost, MotionError, PositionLost, Stopped
from tests.rig.driver_steps import STEP, order, truly

SLOW = np.full(6, 2e-4)  # m/s; homing takes ten seconds


def test_a_homing_that_fails_stops_the_axes_that_home_on(driven_design, protocol):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, protocol, ("homes-on",), 1)
    driver.open()
    with pytest.raises(ControllerFault, match="homing failed"):
        driver.home()
    stood = truly(emulator, clock)
    assert np.abs(stood - home_lengths(driven_design.mechanism)).max() > 1e-4  # it was on its way
    clock.sleep(10)
    np.testing.assert_allclose(truly(emulator, clock), stood, atol=1e-9)
    with pytest.raises(MotionError):
        driver.move(stood)


def test_an_interrupt_stops_a_rig_that_homes(driven_design, protocol, monkeypatch):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, protocol, (), 1, max_speed=SLOW)
    driver.open()
    sleep = clock.sleep

    def interrupted(seconds):
        if emulator.machine.homing(clock.now()):
            monkeypatch.setattr(clock, "sleep", sleep)
            raise KeyboardInterrupt
        sleep(min(seconds, 0.05))

    monkeypatch.setattr(clock, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        driver.home()
    _stands_before_home(driver, emulator, clock, driven_design)


def test_a_rig_that_homes_for_another_process_is_stopped(driven_design, protocol):
    if protocol == "urscript":
        pytest.skip("its encoders are absolute: it needs no homing to know its position")
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, protocol, (), 1, max_speed=SLOW)
    emulator.machine.start_homing(clock.now())
    clock.sleep(0.01)
    assert driver.open(stopping=True).activity != "homing"
    _stands_before_home(driver, emulator, clock, driven_design)


def test_a_rig_that_moves_for_another_process_is_stopped_and_keeps_its_position(ready):
    driver, emulator, clock, home = ready
    emulator.machine.go(clock.now(), emulator.machine.counters(clock.now()) + 8e-3, 1.0)
    clock.sleep(0.3)
    other = Driver(driver.design, clock, lambda: EmulatorPort(emulator, clock))
    status = other.open(stopping=True)
    assert status.activity == "idle" and status.known
    stood = truly(emulator, clock)
    clock.sleep(10)
    np.testing.assert_allclose(truly(emulator, clock), stood, atol=1e-9)
    assert np.abs(stood - home - 8e-3).max() > 1e-3
    np.testing.assert_allclose(status.lengths, stood, atol=1e-6)


def test_homing_that_takes_too_long_is_stopped(driven_design, protocol):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(
        driven_design, protocol, (), 1, max_speed=SLOW, home_timeout=0.5
    )
    driver.open()
    with pytest.raises(ControllerFault, match="0.5 s"):
        driver.home()
    _stands_before_home(driver, emulator, clock, driven_design)


def _stands_before_home(driver, emulator, clock, design):
    clock.sleep(10)
    assert np.abs(truly(emulator, clock) - home_lengths(design.mechanism)).max() > 1e-4
    status = driver.status()
    assert not status.known and status.activity in ("idle", "alarm", "off")


def test_an_interrupt_from_the_keyboard_stops_the_struts(ready, monkeypatch):
    driver, emulator, clock, home = ready
    sleep, end = clock.sleep, clock.now() + 0.2

    def interrupted(seconds):
        if clock.now() > end:
            monkeypatch.setattr(clock, "sleep", sleep)
            raise KeyboardInterrupt
        sleep(seconds)

    monkeypatch.setattr(clock, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        driver.move(home + 10 * STEP)
    stood = truly(emulator, clock)
    clock.sleep(10)
    assert np.abs(stood - home).max() < 9e-3 and np.allclose(truly(emulator, clock), stood, atol=1e-9)
    driver.move(home) if driver.status().known else driver.home()


def test_a_stop_from_another_thread_ends_the_move(ready, monkeypatch):
    driver, emulator, clock, home = ready
    sleep, requested, stopped = clock.sleep, threading.Event(), []

    def watched(seconds):
        sleep(seconds)
        if emulator.machine.executed and not requested.is_set():
            requested.set()
            thread = threading.Thread(target=lambda: stopped.append(driver.stop()))
            thread.start()
            while not driver.link._stop.is_set():
                thread.join(1e-4)
            watched.thread = thread

    monkeypatch.setattr(clock, "sleep", watched)
    with pytest.raises(Stopped):
        driver.move(home + 10 * STEP)
    watched.thread.join(10)
    assert len(stopped) == 1 and stopped[0].activity != "moving"
    assert np.abs(truly(emulator, clock) - home).max() < 9e-3 and len(emulator.machine.executed) == 1


def test_a_controller_that_starts_anew_between_moves_is_noticed(ready):
    driver, emulator, clock, home = ready
    driver.move(home + STEP)
    emulator.power_cycle()
    with pytest.raises((PositionLost, ControllerFault)):
        driver.move(home)
    assert len(emulator.machine.executed) == 1 and not driver.status().known
    if driver.status().activity == "off":
        driver.unlock()
    driver.home()
    driver.move(home + STEP)
    np.testing.assert_allclose(truly(emulator, clock), home + STEP, atol=1e-6)


def test_a_line_that_stays_cut_is_an_error_in_bounded_time(ready):
    driver, emulator, clock, home = ready
    emulator.unplug(1e6)
    begun = clock.now()
    with pytest.raises(LinkLost, match="unplugged"):
        driver.move(home + STEP)
    assert clock.now() - begun < 60 and not emulator.machine.executed


def test_a_port_that_comes_back_under_another_name_is_found(driven_design, monkeypatch):
    from types import SimpleNamespace

    from serial.tools import list_ports

    from rig.driving.serial_and_epics_ports_and_checksummed_frames import find_usb_port

    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "struts", (), 1)
    opened, here = (
        [],
        lambda name: [
            SimpleNamespace(device=name, serial_number="A9", hwid="USB VID:PID=2341:0042 SER=A9 LOCATION=1-2"),
            SimpleNamespace(device="/dev/ttyS0", serial_number=None, hwid="n/a"),
        ],
    )

    def opener():
        name = f"/dev/ttyACM{emulator.replugged}" if emulator.plugged else "/dev/none"
        monkeypatch.setattr(list_ports, "comports", lambda: here(name))
        opened.append(find_usb_port("/dev/ttyACM0", "A9"))
        return EmulatorPort(emulator, clock)

    driver = Driver(driven_design_with(driven_design, "struts"), clock, opener)
    driver.open()
    driver.home()
    order(emulator, "unplug")
    driver.move(home_lengths(driven_design.mechanism) + STEP)
    assert (
        opened[0] == "/dev/ttyACM0"
        and opened[-1] == "/dev/ttyACM1"
        and find_usb_port("x", "2341:0042") == "/dev/ttyACM1"
    )
    with pytest.raises(LinkLost, match="0 ports answer"):
        find_usb_port("/dev/ttyACM0", "B7")


def driven_design_with(design, protocol):
    return replace(design, controller=replace(design.controller, protocol=protocol))
