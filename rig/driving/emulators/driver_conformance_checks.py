"""Conformance checks of a driver with its emulator.

Of a protocol: through each fault, stops, restarts and cut lines.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from rig.driving.emulators.controller_emulator_opening_and_ports import home_lengths
from rig.driving.emulators.emulated_axes_and_faults import ALWAYS, KINDS
from rig.driving.emulators.fault_trials import (
    ARRIVED,
    LONGEST,
    bring_home,
    emulated_driver_with_emulator_and_clock,
    move_counts_with_faults,
    move_execution_count,
)
from rig.driving.move_profiles_and_path_check import straight_move_segment
from rig.driving.user_classes_and_sensor_reader import refuse_programs_of_untrusted_rig_toml
from rig.errors import ControllerFault, LinkLost, MotionError, PositionLost, RigError, Stopped
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.rig_toml.design_from_rig_toml import design_of_entries, load_design
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_struts
from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions, new_rig_toml

RECOVERED = ("lost-ok", "two-ok", "resend", "resend-moving", "late", "half-line", "garbage", "early-stop", "unplug")
ON_RESETS = ("stale-alarm",)  # faults of controllers that are reset, which lines of text need not have
ONCE, EACH = 4, 12  # trials with a fault at the first move; moves with the fault at one in five
STEP, RADIUS = 8e-3, 0.3  # m, of a move; of the hexapod where no rig.toml is given
USUAL, FAST, SLOW = (0.01, 0.1), (0.1, 5.0), (2e-4, 0.1)  # m/s, m/s^2; many moves shall take little time, homing long


@dataclass(frozen=True, slots=True)
class ConformanceCheck:
    """One check. name : what was tried; problem : "" where the driver did as it must; found : figures"""

    name: str
    problem: str
    found: str = ""


def check_conformance(design: Design, protocol: str, moves: int = 300, seed: int = 1) -> Iterator[ConformanceCheck]:
    """Each ConformanceCheck of a protocol, as it is done; only the first where that fails.

    design : a rig of struts with a controller; protocol : as rig.toml states it; moves : with all faults at 5 %
    Raises FileError or RigError for a program of the user's own that cannot be used
    """
    design = _at_speed(design, USUAL)
    emulated_driver_with_emulator_and_clock(design, protocol)
    checks: list[tuple[str, Callable[[Design, str, int], str]]] = [
        ("greets, homes and moves", _moves),
        ("a move before homing", _refused),
        ("stops while it moves", _stops_moving),
        ("stops while it homes", _stops_homing),
        ("restarted between two moves", _restarted),
        ("connection cut for good", _cut),
        ("homes-on: an axis fails to home, and the others home on", _homing_fails),
        *((f"{kind}: {text}", partial(_fault, kind=kind)) for kind, text in KINDS.items() if kind != "homes-on"),
        (f"{moves} moves with all faults at 5 %", partial(_many, moves=moves)),
    ]
    for name, check in checks:
        try:
            yield ConformanceCheck(name, "", check(design, protocol, seed))
        except RigError as error:
            yield ConformanceCheck(name, str(error) or type(error).__name__)
            if check is _moves:
                return  # what does not move at all is tried no further


def conformance_design(path: Path | None) -> Design:
    """Design on which a protocol's conformance is tested.

    Of a rig.toml, or a hexapod.
    Raises RigError for one without struts or controller, and FileError.
    """
    if path is None:
        text = new_rig_toml(LayoutOptions(radius=RADIUS))
        return design_of_entries(toml_entries(text, Path("hexapod.toml")))
    design = load_design(path)
    refuse_programs_of_untrusted_rig_toml(path, design)
    design.driver()
    return design


def _require(holds: bool, problem: str) -> None:
    if not holds:
        raise RigError(problem)


def _moves(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home = home_lengths(require_struts(design.mechanism))
    clock.allow(10 * LONGEST)
    name = driver.link.protocol.name
    driver.open()
    driver.home()
    for k in range(3):
        target = home + STEP * (-0.5) ** k * np.cos(np.arange(len(home)))
        driver.move(target)
        off = float(np.abs(emulator.machine.axes.at(clock.now()) - target).max())
        _require(off <= ARRIVED, f"a move ended {off * 1e3:.4f} mm from its goal and was reported as done")
    return f"{name}: {len(emulator.machine.executed)} moves"


def _refused(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    mechanism = require_struts(design.mechanism)
    home = home_lengths(mechanism)
    clock.allow(LONGEST)
    driver.open()
    segment = straight_move_segment(home, home + STEP, 1.0, driver.controller, mechanism)
    verdict = driver.link.run(driver.link.protocol.move(segment))
    if verdict.accepted:
        return "acknowledged: the driver alone refuses that"
    understood = verdict.accepted is False and bool(verdict.reason)
    _require(understood, "it was refused, and the answer fits no pattern as a whole, as `refused`, with a reason")
    return f"refused: {verdict.reason}"


def _stops_moving(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home = home_lengths(require_struts(design.mechanism))
    driver.open()
    driver.home()
    stopped_by = []

    def interrupt() -> None:
        driver.link.interrupt()
        emulator.due()
        stopped_by.append(emulator.machine.axes.until - clock.now())

    clock.action_time, clock.action = clock.now() + 0.5, interrupt
    clock.allow(LONGEST)
    try:
        driver.move(home + STEP)
    except Stopped:
        driver.link.resume()
    else:
        raise RigError("a stop during a move did not end it")
    _require(stopped_by[0] < 0.3, f"urgent_stop did not slow the axes down: {stopped_by[0]:.2f} s were left")
    state = driver.stop()
    _require(state.activity != "moving", f"it is {state.activity} after a stop")
    stood = emulator.machine.axes.at(clock.now())
    clock.sleep(10)
    _require(bool(np.allclose(emulator.machine.axes.at(clock.now()), stood, atol=1e-9)), "it moved on after a stop")
    driver.move(home) if driver.position_known else bring_home(driver, emulator)
    return f"{stopped_by[0] * 1e3:.0f} ms to rest"


def _stops_homing(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(_at_speed(design, SLOW), protocol, (), seed)
    driver.open()
    clock.action_time, clock.action = clock.now() + 1.0, driver.link.interrupt
    clock.allow(LONGEST)
    try:
        driver.home()
    except MotionError:
        driver.link.resume()
    else:
        raise RigError("a stop during homing did not end it")
    until = emulator.machine.axes.until - clock.now()
    _require(until < 0.5, f"the axes home on for {until:.1f} s after a stop")
    _require(not driver.position_known, "a homing that was stopped is taken for done")
    return ""


def _restarted(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home = home_lengths(require_struts(design.mechanism))
    driver.open()
    driver.home()
    driver.move(home + 1e-3)
    emulator.power_cycle()
    clock.allow(LONGEST)
    try:
        driver.move(home)
    except (PositionLost, ControllerFault) as error:
        found = str(error)
    else:
        raise RigError("a restart between two moves was not noticed: what identity gives must be another after it")
    _require(len(emulator.machine.executed) == 1, "it moved after a restart, with its position lost")
    bring_home(driver, emulator)
    driver.move(home)
    return found.splitlines()[0]


def _cut(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    driver.open()
    driver.home()
    emulator.unplug(1e6)
    clock.allow(LONGEST)
    try:
        driver.move(home_lengths(require_struts(design.mechanism)) + 1e-3)
    except LinkLost as error:
        return str(error)
    raise RigError("a move over a line that is cut was reported as done")


def _fault(design: Design, protocol: str, seed: int, kind: str) -> str:
    if kind in ALWAYS:
        return _small_buffer(design, protocol, seed, kind)
    done, struck, stopped = 0, 0, Counter[str]()
    for k in range(ONCE):
        counts = move_counts_with_faults(design, protocol, [kind], 2, seed + k)
        _require(not counts.failures, _failure_text(counts.failures))
        done, struck, stopped = done + counts.done, struck + counts.struck[kind], stopped + counts.stopped
    ended = ", ".join(f"{count} {name}" for name, count in stopped.items())
    _require(kind not in RECOVERED or not stopped, f"a fault that can be recovered from ended moves: {ended}")
    if not struck:
        _require(kind in ON_RESETS, "the emulator never showed this fault: does it begin its moves by self.move?")
        return "not a fault of this controller"
    counts = move_counts_with_faults(design, protocol, [f"{kind}:0.2"], EACH, seed)
    _require(not counts.failures, _failure_text(counts.failures))
    done, stopped = done + counts.done, stopped + counts.stopped
    ended = ", ".join(f"{count} {name}" for name, count in stopped.items())
    return f"{done} done" + (f", stopped: {ended}" if stopped else "")


def _homing_fails(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(
        _at_speed(design, SLOW), protocol, ("homes-on",), seed
    )
    home = home_lengths(require_struts(design.mechanism))
    driver.open()
    clock.allow(2 * design.driver().home_timeout)
    try:
        driver.home()
    except MotionError as error:
        found = str(error).splitlines()[0]
    else:
        raise RigError("a homing that failed was reported as done")
    clock.sleep(20)
    _require(bool(np.abs(emulator.machine.axes.at(clock.now()) - home)[1:].max() > 1e-4), "the other axes home on")
    _require(not driver.position_known, "the position is believed after a homing that failed")
    return found


def _small_buffer(design: Design, protocol: str, seed: int, kind: str) -> str:
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(design, protocol, (kind,), seed)
    home = home_lengths(require_struts(design.mechanism))
    target = home + 8.123456e-3 * np.cos(np.arange(len(home)))
    driver.open()
    driver.home()
    found = "done"
    try:
        driver.move(target)
    except MotionError as error:
        found = f"refused: {str(error).splitlines()[0]}"
    wrong = len(emulator.machine.executed) - move_execution_count(emulator, 0, target)
    _require(not wrong, f"{wrong} moves to a place that nobody commanded")
    return found


def _many(design: Design, protocol: str, seed: int, moves: int) -> str:
    counts = move_counts_with_faults(_at_speed(design, FAST), protocol, ["all:0.05", "homes-on:0.05"], moves, seed)
    _require(not counts.failures, _failure_text(counts.failures))
    return f"{counts.done} done, {counts.recovered} of them after a fault, {counts.stopped.total()} stopped"


def _at_speed(design: Design, speed: tuple[float, float]) -> Design:
    """The design with this speed (m/s) and acceleration (m/s^2) of all struts."""
    count = len(design.mechanism.axes)
    top, ramp = np.full(count, speed[0]), np.full(count, speed[1])
    return replace(design, controller=replace(design.driver(), max_speed=top, max_acceleration=ramp))


def _failure_text(failures: dict[str, int]) -> str:
    words = {
        "twice": "moves carried out twice",
        "unacknowledged": "moves reported as done that were not",
        "hangs": f"moves that took longer than {LONGEST:g} s",
        "reasonless": "errors without a reason",
        "unsafe": "moves that went on after a stop",
    }
    return "; ".join(f"{count} {words[name]}" for name, count in failures.items())
