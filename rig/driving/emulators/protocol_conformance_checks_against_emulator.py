"""Conformance checks of a driver with its emulator.

Of a protocol: through each fault, stops, restarts and cut lines.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import greatest_distance_text
from rig.driving.axis_driver import Driver
from rig.driving.controller_status_and_limits import hint_at_lengths_wrong_by_factor_of_thousand
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import ALWAYS, KINDS
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.driving.emulators.move_trials_through_emulator_with_faults import (
    LONGEST,
    arrival_tolerance_of_axes,
    emulated_driver_with_emulator_and_clock,
    home_with_fault_recovery,
    move_execution_count,
    run_moves_with_faults_and_count_outcomes,
)
from rig.driving.move_profiles_and_path_check import straight_move_segment
from rig.driving.protocols.protocol_interface_and_user_line_protocol import State
from rig.driving.request_and_answer_exchange_with_controller import bytes_as_text
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import refuse_programs_of_untrusted_rig_toml
from rig.errors import ControllerFault, LinkLost, MotionError, PositionLost, RigError, Stopped
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.rig_toml.design_from_rig_toml import design_of_entries, load_design
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import kinematics_of, require_axes
from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions, new_rig_toml, shipped_arm_path

RECOVERED = ("lost-ok", "two-ok", "resend", "resend-moving", "late", "half-line", "garbage", "early-stop", "unplug")
ON_RESETS = ("stale-alarm",)  # faults of controllers that are reset, which lines of text need not have
ONCE, EACH = 4, 12  # trials with a fault at the first move; moves with the fault at one in five
STEP, RADIUS = 8e-3, 0.3  # m, of a move; of the hexapod where no rig.toml is given
SIX_JOINT_ARM = "ur10"  # of rig/arms, where no rig.toml is given
ARM_CONTROLLER = '\n[controller]\nprotocol = "urscript"\nhoming = false\nmax_speed = 1.0\n'
ZERO_STEP = 1e-3  # m between the zeros of its struts, about the middle of their ranges: positions of both signs occur
SLOW_SHARE = 0.25  # share of full speed, which a move takes that the axes' own limits do not slow down
FASTEST, SLOWEST, RAMPS = 0.5, 3.0, 1.0  # times a segment's duration that its move may take, and s more for its ramps
EXACT = 1e-5  # m or rad, of a read-back
QUESTIONS = 60  # of one state, at most
USUAL, FAST, SLOW = (0.01, 0.1), (0.1, 5.0), (2e-4, 0.1)  # m/s, m/s^2; many moves shall take little time, homing long


@dataclass(frozen=True, slots=True)
class ConformanceCheck:
    """One check. name : what was tried; problem : "" where the driver did as it must; found : figures"""

    name: str
    problem: str
    found: str = ""


def check_protocol_conformance(
    design: Design, protocol: str, moves: int = 300, seed: int = 1
) -> Iterator[ConformanceCheck]:
    """Checks (ConformanceCheck) of a protocol's conformance, each as it is done.

    Only the first where that fails.

    design : a rig of struts with a controller; protocol : as rig.toml states it; moves : with all faults at 5 %
    Raises FileError or RigError for a program of the user's own that cannot be used
    """
    design = _at_speed(design, USUAL)
    emulated_driver_with_emulator_and_clock(design, protocol)
    checks: list[tuple[str, Callable[[Design, str, int], str]]] = [
        ("greets, homes and moves", _moves),
        ("a move before homing", _refused),
        ("is idle where it stands", _idle_where_it_stands),
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


def protocol_conformance_design(path: Path | None, protocol: str | None = None) -> Design:
    """Design on which the conformance of a protocol is checked.

    Of a rig.toml, or a hexapod; of protocol "urscript" an arm of six joints.
    Raises RigError for one without axes or controller, and FileError.
    """
    if path is None and protocol == "urscript":
        text = shipped_arm_path(SIX_JOINT_ARM).read_text(encoding="utf-8") + ARM_CONTROLLER
        return design_of_entries(toml_entries(text, Path(f"{SIX_JOINT_ARM}.toml")))
    if path is None:
        text = new_rig_toml(LayoutOptions(radius=RADIUS))
        design = design_of_entries(toml_entries(text, Path("hexapod.toml")))
        mechanism = require_axes(design.mechanism)
        middle = kinematics_of(mechanism).travel_ranges(mechanism).mean(axis=1)
        zero = middle + ZERO_STEP * (np.arange(len(middle)) - (len(middle) - 1) / 2)
        return replace(design, controller=replace(design.driver(), zero=zero))
    design = load_design(path)
    refuse_programs_of_untrusted_rig_toml(path, design)
    design.driver()
    return design


def _require(holds: bool, problem: str) -> None:
    if not holds:
        raise RigError(problem)


def _moves(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home = home_lengths(require_axes(design.mechanism))
    clock.allow(10 * LONGEST)
    name = driver.link.protocol.name
    driver.open()
    driver.home()
    _require_true_lengths(driver, emulator)
    for step, share in ((STEP, 1.0), (-STEP / 2, 1.0), (STEP / 4, 1.0), (-STEP, SLOW_SHARE)):
        target = home + step * np.cos(np.arange(len(home)))
        duration = straight_move_segment(driver.lengths(), target, share, driver.controller, driver.mechanism).duration
        try:
            driver.move(target, share)
        except MotionError:
            _require_true_lengths(driver, emulator)
            raise
        off = emulator.machine.axes.at(clock.now()) - target
        _require(
            bool(np.abs(off).max() <= arrival_tolerance_of_axes(design)),
            f"a move ended {greatest_distance_text(off, driver.mechanism, 4)} from its goal and was reported as done",
        )
        took = emulator.machine.axes.until - emulator.machine.executed[-1].t
        _require(
            FASTEST * duration <= took <= SLOWEST * duration + RAMPS,
            f"the last move, {bytes_as_text([clock.move_sent])}, took {took:.2f} s, and {duration:.2f} s were expected "
            "(segment.duration): are its speed or duration in the controller's units?",
        )
    return f"{name}: {len(emulator.machine.executed)} moves"


def _require_true_lengths(driver: Driver, emulator: Emulator) -> None:
    """Raise RigError where the lengths that a driver reads are not those of its homed emulator."""
    zero = driver.controller.zero
    read, true = driver.lengths() - zero, emulator.machine.axes.at(emulator.now) - zero
    agrees = bool(np.abs(read - true).max() <= driver.controller.tolerance)
    _require(
        agrees or emulator.busy or not emulator.machine.homed,
        f"`state` gives {read.round(9).tolist()} m, and the axes stand at {true.round(9).tolist()} m"
        f"{hint_at_lengths_wrong_by_factor_of_thousand(read, true)}",
    )


def _refused(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    mechanism = require_axes(design.mechanism)
    home = home_lengths(mechanism)
    clock.allow(LONGEST)
    driver.open()
    _require_homed_as_emulated(driver, emulator, "before it was homed")
    segment = straight_move_segment(home, home + STEP, 1.0, driver.controller, mechanism)
    verdict = driver.link.run(driver.link.protocol.move(segment))
    if verdict.accepted:
        return "acknowledged: the driver alone refuses that"
    understood = verdict.accepted is False and bool(verdict.reason)
    _require(understood, "it was refused, and the answer fits no pattern as a whole, as `refused`, with a reason")
    return f"refused: {verdict.reason}"


def _require_homed_as_emulated(driver: Driver, emulator: Emulator, when: str) -> State:
    """The State that a driver reads. Raises RigError where it is homed, and its emulator is not."""
    state = driver.link.run(driver.link.protocol.state())
    _require(emulator.machine.homed or state.homed is not True, f"`state` has homed True {when}")
    return state


def _idle_where_it_stands(design: Design, protocol: str, seed: int) -> str:
    """Moves that end between two requests of one `state`: "idle" must not go with a position from before."""
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home, axes = home_lengths(require_axes(design.mechanism)), emulator.machine.axes
    driver.open()
    driver.home()
    clock.allow(QUESTIONS * LONGEST)
    asked = 0

    def end_of_move() -> None:
        nonlocal asked
        asked += 1
        if asked == late:
            clock.sleep(max(axes.until - clock.now(), 0.0) + 0.1)

    for late in range(2, QUESTIONS + 2):
        target = home + STEP * (-1) ** late * np.cos(np.arange(len(home)))
        segment = straight_move_segment(axes.at(clock.now()), target, 1.0, driver.controller, driver.mechanism)
        driver.link.run(driver.link.protocol.move(segment))
        clock.sleep(0.3)
        asked, clock.before_write = 0, end_of_move
        state = driver.link.run(driver.link.protocol.state())
        clock.before_write = lambda: None
        if asked < late:
            return "by one request" if asked == 1 else f"by {asked} requests"
        off = cast(Floats, state.positions) + driver.controller.zero - axes.at(clock.now())
        _require(
            state.activity != "idle" or bool(np.abs(off).max() <= driver.controller.tolerance),
            f"`state` is idle, with positions {greatest_distance_text(off, driver.mechanism)} from where the axes "
            "stand: they are asked for before the status, and the move ended in between; ask for the status first, or "
            "for both at once",
        )
        clock.sleep(max(axes.until - clock.now(), 0.0) + 0.1)
    raise RigError(f"`state` takes more than {QUESTIONS} requests")


def _stops_moving(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home = home_lengths(require_axes(design.mechanism))
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
    driver.move(home) if driver.position_known else home_with_fault_recovery(driver, emulator)
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
    return "at rest, and not homed"


def _restarted(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    home = home_lengths(require_axes(design.mechanism))
    driver.open()
    driver.home()
    driver.move(home + 1e-3)
    emulator.power_cycle()
    clock.allow(LONGEST)
    same = driver.link.run(driver.link.protocol.fence())
    fallen = _require_homed_as_emulated(driver, emulator, "after a restart").homed is False
    _require(not same or fallen, "a restart is not seen: identity is the same and homed has not fallen")
    try:
        driver.move(home)
    except (PositionLost, ControllerFault) as error:
        found = str(error)
    else:
        raise RigError("a restart between two moves was not noticed: what identity gives must be another after it")
    _require(len(emulator.machine.executed) == 1, "it moved after a restart, with its position lost")
    home_with_fault_recovery(driver, emulator)
    driver.move(home)
    seen = " and ".join(["identity"] * (not same) + ["homed"] * fallen)
    return f"shown by {seen}: {found.splitlines()[0]}"


def _cut(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, (), seed)
    driver.open()
    driver.home()
    emulator.unplug(1e6)
    clock.allow(LONGEST)
    try:
        driver.move(home_lengths(require_axes(design.mechanism)) + 1e-3)
    except LinkLost as error:
        return str(error)
    raise RigError("a move over a line that is cut was reported as done")


def _fault(design: Design, protocol: str, seed: int, kind: str) -> str:
    if kind in ALWAYS:
        return _small_buffer(design, protocol, seed, kind)
    done, struck, stopped = 0, 0, Counter[str]()
    for k in range(ONCE):
        counts = run_moves_with_faults_and_count_outcomes(design, protocol, [kind], 2, seed + k)
        _require(not counts.failures, _failure_text(counts.failures))
        done, struck, stopped = done + counts.done, struck + counts.struck[kind], stopped + counts.stopped
    ended = ", ".join(f"{count} {name}" for name, count in stopped.items())
    _require(kind not in RECOVERED or not stopped, f"a fault that can be recovered from ended moves: {ended}")
    if not struck:
        _require(kind in ON_RESETS, "the emulator never showed this fault: does it begin its moves by self.move?")
        return "not a fault of this controller"
    counts = run_moves_with_faults_and_count_outcomes(design, protocol, [f"{kind}:0.2"], EACH, seed)
    _require(not counts.failures, _failure_text(counts.failures))
    done, stopped = done + counts.done, stopped + counts.stopped
    ended = ", ".join(f"{count} {name}" for name, count in stopped.items())
    return f"{done} done" + (f", stopped: {ended}" if stopped else "")


def _homing_fails(design: Design, protocol: str, seed: int) -> str:
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(
        _at_speed(design, SLOW), protocol, ("homes-on",), seed
    )
    home = home_lengths(require_axes(design.mechanism))
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
    home = home_lengths(require_axes(design.mechanism))
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
    counts = run_moves_with_faults_and_count_outcomes(
        _at_speed(design, FAST), protocol, ["all:0.05", "homes-on:0.05"], moves, seed
    )
    _require(not counts.failures, _failure_text(counts.failures))
    return f"{counts.done} done, {counts.recovered} of them after a fault, {counts.stopped.total()} stopped"


def _at_speed(design: Design, speed: tuple[float, float]) -> Design:
    """The design with this speed (m/s or rad/s) and acceleration of all axes, that can home, with read-backs as exact
    as emulators give them.
    """
    count, tolerance = len(design.mechanism.axes), design.driver().tolerance
    top, ramp = np.full(count, speed[0]), np.full(count, speed[1])
    return replace(
        design,
        controller=replace(
            design.driver(), max_speed=top, max_acceleration=ramp, homing=True, tolerance=min(tolerance, EXACT)
        ),
    )


def _failure_text(failures: dict[str, int]) -> str:
    words = {
        "twice": "moves carried out twice",
        "unacknowledged": "moves reported as done that were not",
        "hangs": f"moves that took longer than {LONGEST:g} s",
        "reasonless": "errors without a reason",
        "unsafe": "moves that went on after a stop",
    }
    return "; ".join(f"{count} {words[name]}" for name, count in failures.items())
