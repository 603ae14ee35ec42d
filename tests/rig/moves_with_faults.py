"""Many moves through an emulator with faults; the emulator, which counts what it carried out, is the judge."""

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from rig.driving import emulators
from rig.driving.clock import SimulatedClock
from rig.driving.emulators.controller_emulator_opening_and_ports import EmulatorPort, home_lengths
from rig.driving.emulators.controller_faults import Faults, parse_faults
from rig.driving.strut_driver import Driver
from rig.errors import MotionError, PositionLost

ARRIVED = 2e-6  # m of the true struts; the wires' resolution
LONGEST = 120.0  # s on the clock that a move may take, faults and all; more is a hang


@dataclass
class Verdicts:
    """What became of moves; twice, unacknowledged and hangs are failures of the driver."""

    done: int = 0
    recovered: int = 0
    stopped: Counter = field(default_factory=Counter)
    struck: Counter = field(default_factory=Counter)
    twice: int = 0
    unacknowledged: int = 0
    hangs: int = 0
    reasonless: int = 0
    unsafe: int = 0
    cases: list = field(default_factory=list)


def bench(design, protocol, orders, seed, **controller):
    """(driver, emulator, clock) of a design's controller on a simulated clock."""
    clock = SimulatedClock(1000.0)
    design = replace(design, controller=replace(design.controller, protocol=protocol, **controller))
    faults = Faults(sum((parse_faults(order) for order in orders), ()), np.random.default_rng(seed))
    emulator = emulators.emulator_of_design(design, faults, clock, home_lengths(design.mechanism) + 1e-3)
    driver = Driver(design, clock, lambda: EmulatorPort(emulator, clock))
    return driver, emulator, clock


def judged(design, protocol, orders, moves, seed, **controller):
    """Verdicts on moves to places that are all different, with an operator who homes, unlocks and switches off and on
    where a move was stopped.
    """
    driver, emulator, clock = bench(design, protocol, orders, seed, **controller)
    home, rng, verdicts = home_lengths(design.mechanism), np.random.default_rng(seed + 1), Verdicts()
    driver.open()
    _recover(driver, emulator)
    for k in range(moves):
        target = np.round(home + rng.uniform(-2e-3, 2e-3, len(home)), 6)
        before, begun = len(emulator.machine.executed), clock.now()
        struck = len(emulator.faults.struck)
        try:
            note = driver.move(target).note
            verdicts.done += 1
            verdicts.recovered += bool(note)
            if _count(emulator, before, target) != 1 or _off(emulator, clock, target) > ARRIVED:
                verdicts.unacknowledged += 1
                verdicts.cases.append(
                    (
                        k,
                        note,
                        _count(emulator, before, target),
                        _off(emulator, clock, target),
                        emulator.faults.struck[struck:],
                    )
                )
        except MotionError as error:
            verdicts.stopped[type(error).__name__] += 1
            verdicts.reasonless += len(str(error)) < 15
            verdicts.unsafe += bool(
                emulator.machine.axes.until > clock.now() + 1.0
            )  # still on its way after all the driver did
            _recover(driver, emulator)
        verdicts.twice += int(_count(emulator, before, target) > 1)
        verdicts.hangs += int(clock.now() - begun > LONGEST)
        verdicts.struck.update(emulator.faults.struck[struck:])
    return verdicts


def _count(emulator, before, target):
    return sum(bool(np.abs(one.target - target).max() < 1e-5) for one in emulator.machine.executed[before:])


def _off(emulator, clock, target):
    return float(np.abs(emulator.machine.axes.at(clock.now()) - target).max())


def _recover(driver, emulator):
    """What an operator does until the rig is at home again: home; where that fails, clear the alarm; at last switch off
    and on.
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
        except (MotionError, PositionLost) as error:
            last = error
    raise AssertionError(f"cannot be brought home again: {last}")
