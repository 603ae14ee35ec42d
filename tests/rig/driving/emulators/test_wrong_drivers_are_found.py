"""A driver that is wrong by one edit fails at the check of what is wrong in it."""

import re

import pytest

from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.emulators.protocol_conformance_checks_against_emulator import (
    check_protocol_conformance,
    protocol_conformance_design,
)
from rig.errors import PositionLost
from tests.rig.driving.protocols.test_user_protocol import TEMPLATE

QUESTION = 'yield from self.ask("# POS", r"# (idle|moving|homing|alarm) ([01]) (\\S+)((?: -?\\d{1,10}){6})")'
MOVES, HOMING, RESTARTED = "greets, homes and moves", "a move before homing", "restarted between two moves"
ALWAYS_HOMED = ('found[2] == "1", fault', "True, fault")
CONSTANT_IDENTITY = ("return found[1], found[2]", 'return found[1], ""')
DURATION = "{1e3 * segment.duration"


def two_questions(name, old):
    """Edits by which the group `old` of a state is of a question asked before the other."""
    return [
        (f"found = {QUESTION}", f"{name} = {QUESTION}\n        found = {QUESTION}"),
        (old, old.replace("found", name)),
    ]


POSITION_FIRST, STATUS_FIRST = two_questions("place", "found[4].split()"), two_questions("status", "State(found[1]")
WRONG = {  # edits, which check fails, with which words
    "too fast": ([(DURATION, "{segment.duration")], MOVES, r"GO 4 .* took 1\.\d+ s, and 4\.\d+ s were expected"),
    "too slow": ([(DURATION, "{1e6 * segment.duration")], MOVES, r"GO .* is to take 0\.\d+ s"),
    "no minus sign": ([("(?: -?", "(?: ")], MOVES, "no answer to '# POS'"),
    "always homed": ([ALWAYS_HOMED], HOMING, "`state` has homed True before"),
    "always homed, the same identity": (
        [ALWAYS_HOMED, CONSTANT_IDENTITY],
        RESTARTED,
        "identity is the same and homed has not fallen|homed True after a restart",
    ),
    "a position older than its status": (POSITION_FIRST, "is idle where it stands", "asked for before the status"),
}
RIGHT = {"the same identity": [CONSTANT_IDENTITY], "a position newer than its status": STATUS_FIRST}


def edited(folder, edits):
    """The example protocol with these edits, as rig.toml states it."""
    text = TEMPLATE
    for old, new in edits:
        assert text.count(old) == 1
        text = text.replace(old, new)
    (folder / "mine.py").write_text(text)
    return f"file:{folder / 'mine.py'}"


def checked(folder, edits, last):
    """{check: ConformanceCheck} of the example with these edits, up to the check `last`."""
    checks = {}
    for check in check_protocol_conformance(protocol_conformance_design(None), edited(folder, edits), 1):
        checks[check.name] = check
        if check.name == last:
            break
    return checks


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_driver_fails_at_what_is_wrong_in_it(tmp_path, name):
    edits, last, words = WRONG[name]
    problem = checked(tmp_path, edits, last)[last].problem
    assert re.search(words, problem), problem


@pytest.mark.parametrize("name", RIGHT)
def test_a_driver_that_finds_the_same_in_another_way_passes(tmp_path, name):
    checks = checked(tmp_path, RIGHT[name], RESTARTED)
    assert {name: check.problem for name, check in checks.items() if check.problem} == {}


def test_what_shows_a_restart_is_named(tmp_path):
    assert checked(tmp_path, [CONSTANT_IDENTITY], RESTARTED)[RESTARTED].found.startswith("shown by homed: ")


def test_positions_of_both_signs_are_tried():
    zero = protocol_conformance_design(None).driver().zero
    assert len(set(zero)) == len(zero)


def test_a_restart_during_a_move_to_where_counters_begin_is_no_arrival(tmp_path):
    design = protocol_conformance_design(None)
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(design, edited(tmp_path, [CONSTANT_IDENTITY]))
    driver.open()
    driver.home()
    clock.action_time, clock.action = clock.now() + 0.15, emulator.power_cycle
    with pytest.raises(PositionLost, match="while moving: it is no longer homed"):
        driver.move(design.driver().zero)
    assert len(emulator.machine.executed) == 1 and not driver.position_known
