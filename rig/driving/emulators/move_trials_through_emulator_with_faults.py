"""Fault trials: many moves through an emulator with faults.

The emulator, which counts what it carried out, is the judge.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_driver import Driver
from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import Faults, parse_fault_orders
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import (
    EmulatorPort,
    emulator_of_design,
    home_lengths,
)
from rig.driving.request_and_answer_exchange_with_controller import bytes_as_text
from rig.errors import ControllerFault, MotionError, RigError
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import axis_units, require_axes

ARRIVED = {"m": 2e-6, "rad": 2e-5}  # of the true axes; the wires' resolution, 0.001 mm or degrees
LONGEST = 120.0  # s on the clock that a move may take, faults and all; more is a hang
NEVER_ENDS = 3600.0  # s on the clock after which a move is broken off
WAITS = 30_000  # of a move, after which it is broken off
WRITING = 1e-5  # s
RANGE = 2e-3  # m from home within which the moves go


class TrialClock(SimulatedClock):
    """A simulated clock that calls `action` at `action_time` (s), and breaks off what waits too long or too often.

    before_write : called before bytes go to the emulator; move_sent : those that began the last move
    progress : words on the last move, for what is broken off
    """

    def __init__(self, start: float = 1000.0) -> None:
        super().__init__(start)
        self.action_time = np.inf
        self.action: Callable[[], None] = lambda: None
        self.before_write: Callable[[], None] = lambda: None
        self.move_sent = b""
        self.progress: Callable[[], str] = str
        self.allow(NEVER_ENDS)

    def allow(self, seconds: float) -> None:
        """What waits longer than this from now on (s), or more than WAITS times, is broken off."""
        self._allowed, self._deadline, self._waits = seconds, self.now() + seconds, WAITS

    def sleep(self, seconds: float) -> None:
        if self.now() + seconds >= self.action_time:
            super().sleep(self.action_time - self.now())
            seconds, self.action_time = max(self.action_time + seconds - self.now(), 0.0), np.inf
            self.action()
        super().sleep(seconds)
        self._waits -= 1
        if self.now() > self._deadline or self._waits < 0:
            self.allow(self._allowed)  # for what stops the axes then
            raise RigError(f"it waits without an end{self.progress()}")


class TrialPort(EmulatorPort):
    """An EmulatorPort whose writes take a moment, so that time passes for who only asks and is answered at once.

    emulator, clock : as of an EmulatorPort
    """

    def __init__(self, emulator: Emulator, clock: TrialClock) -> None:
        super().__init__(emulator, clock)
        self._trial = clock

    def write(self, data: bytes) -> None:
        self._trial.before_write()
        self._trial.sleep(WRITING)
        moves = len(self._emulator.machine.executed)
        super().write(data)
        if len(self._emulator.machine.executed) > moves:
            self._trial.move_sent = data


@dataclass(slots=True)
class MoveCounts:
    """What became of moves. done : arrived; recovered : of these, after something was noticed; stopped : {error: how
    many}; struck : {fault: how many}. Failures of the driver: twice (carried out more than once), unacknowledged
    (reported as done and not so), hangs, reasonless (an error without a reason), unsafe (still on its way after it was
    stopped); cases : of unacknowledged (number, note, times carried out, m from the goal, faults)
    """

    done: int = 0
    recovered: int = 0
    stopped: Counter[str] = field(default_factory=Counter)
    struck: Counter[str] = field(default_factory=Counter)
    twice: int = 0
    unacknowledged: int = 0
    hangs: int = 0
    reasonless: int = 0
    unsafe: int = 0
    cases: list[tuple[int, str, int, float, tuple[str, ...]]] = field(default_factory=list)

    @property
    def failures(self) -> dict[str, int]:
        """{failure: how many} of those that happened."""
        names = ("twice", "unacknowledged", "hangs", "reasonless", "unsafe")
        return {name: getattr(self, name) for name in names if getattr(self, name)}


def emulated_driver_with_emulator_and_clock(
    design: Design, protocol: str, fault_texts: Sequence[str] = (), seed: int = 1, **controller: object
) -> tuple[Driver, Emulator, TrialClock]:
    """Driver, emulator and simulated clock of a design's emulated controller.

    protocol : as rig.toml states it; fault_texts : each KIND or KIND:RATE; controller : other entries of [controller]

    Returns (driver, emulator, clock), on a simulated clock, the struts 1 mm from home
    """
    clock = TrialClock()
    stated: dict[str, Any] = {"protocol": protocol, "home": _home(design), **controller}
    design = replace(design, controller=replace(design.driver(), **stated))
    faults = Faults(sum((parse_fault_orders(text) for text in fault_texts), ()), np.random.default_rng(seed))
    emulator = emulator_of_design(design, faults, clock, _home(design) + 1e-3)
    clock.progress = partial(_progress_of_last_move, emulator, clock)
    return Driver(design, clock, lambda: TrialPort(emulator, clock)), emulator, clock


def _progress_of_last_move(emulator: Emulator, clock: TrialClock) -> str:
    """How far the last move is, with its line and the time that it takes at full speed; "" where none was begun."""
    machine = emulator.machine
    if not machine.executed:
        return ""
    last, now = machine.executed[-1], clock.now()
    travel, left = (np.abs(last.target - machine.axes.at(t)).max() for t in (last.t, now))
    seconds = (np.abs(last.target - machine.axes.at(last.t)) / machine.axes.speed).max()
    return (
        f": the last move, {bytes_as_text([clock.move_sent])}, is to take {seconds:.2f} s at full speed; "
        f"{now - last.t:.1f} s after its begin {1e3 * (travel - left):.3f} of {1e3 * travel:.3f} mm are done"
    )


def run_moves_with_faults_and_count_outcomes(
    design: Design, protocol: str, fault_texts: Sequence[str], moves: int, seed: int, **controller: object
) -> MoveCounts:
    """Run moves with faults and count their outcomes (MoveCounts).

    They go to places that are all different.

    Where a move was stopped, an operator homes, unlocks and switches off and on.
    Raises ControllerFault for a controller that cannot be brought home again.
    """
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, protocol, fault_texts, seed, **controller)
    home, rng, counts = _home(design), np.random.default_rng(seed + 1), MoveCounts()
    driver.open()
    home_with_fault_recovery(driver, emulator)
    for k in range(moves):
        target = np.round(home + rng.uniform(-RANGE, RANGE, len(home)), 6)
        before, begun = len(emulator.machine.executed), clock.now()
        struck = len(emulator.faults.struck)
        clock.allow(NEVER_ENDS)
        try:
            note = driver.move(target).note
            counts.done += 1
            counts.recovered += bool(note)
            times, off = move_execution_count(emulator, before, target), _off(emulator, clock, target)
            if times != 1 or off > arrival_tolerance_of_axes(design):
                counts.unacknowledged += 1
                counts.cases.append((k, note, times, off, tuple(emulator.faults.struck[struck:])))
        except MotionError as error:
            counts.stopped[type(error).__name__] += 1
            counts.reasonless += len(str(error)) < 15
            still_moving = emulator.machine.axes.until > clock.now() + 1.0
            counts.unsafe += still_moving  # after all that the driver did
            home_with_fault_recovery(driver, emulator)
        counts.twice += int(move_execution_count(emulator, before, target) > 1)
        counts.hangs += int(clock.now() - begun > LONGEST)
        counts.struck.update(emulator.faults.struck[struck:])
    return counts


def arrival_tolerance_of_axes(design: Design) -> float:
    """Tolerance, m or rad, within which a design's axes count as arrived.

    Of machines with both, rad.
    """
    return max(ARRIVED[unit] for unit in axis_units(design.mechanism))


def move_execution_count(emulator: Emulator, skipped_moves: int, target: Floats) -> int:
    """How many times a move to target (axes,) m was executed.

    After the first `skipped_moves`.
    """
    return sum(bool(np.abs(one.target - target).max() < 1e-5) for one in emulator.machine.executed[skipped_moves:])


def home_with_fault_recovery(driver: Driver, emulator: Emulator) -> None:
    """Home a rig, recovering from faults as an operator does.

    Home; where that fails, clear the alarm; at last switch off and on.
    Raises ControllerFault where nothing helps.
    """
    for attempt in range(12):
        try:
            if attempt % 3 == 1:
                driver.unlock()
            elif attempt % 3 == 2:
                emulator.power_cycle()
                driver.unlock()
            driver.home()
            return
        except MotionError as error:
            last = error
    raise ControllerFault(f"it cannot be brought home again: {last}") from last


def _home(design: Design) -> Floats:
    return home_lengths(require_axes(design.mechanism))


def _off(emulator: Emulator, clock: TrialClock, target: Floats) -> float:
    return float(np.abs(emulator.machine.axes.at(clock.now()) - target).max())
