"""A protocol of the user's own: what is wrong with its file is told with file and line, before and while it drives."""

from dataclasses import replace

import pytest

from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.move_profiles_and_path_check import require_safe_path
from rig.driving.protocols.protocol_selection_and_user_protocols import protocol_of_controller
from rig.errors import ControllerFault, FileError, PositionLost, Unreachable
from tests.conftest import ROOT

TEMPLATE = (ROOT / "rig" / "driving" / "example_user_protocol_with_emulator.py").read_text()
LACKS = [  # what stands in place of what, what is said of it
    ("import numpy as np", "import numpy as np oh", r"mine.py:3:\d+: is no Python"),
    ("import numpy as np", "import nothing_of_the_kind", "mine.py:3: cannot be run: ModuleNotFoundError"),
    ("class Acme(LineProtocol)", "class Acme", r"defines no protocol: class Mine\(LineProtocol\)"),
    ('    name = "acme"\n', "", "mine.py:8: Acme lacks name"),
    ('urgent_stop = b"!"', 'urgent_stop = "!"', "mine.py:12: Acme lacks urgent_stop, bytes as a literal"),
    ('urgent_stop = b"!"', "urgent_stop = bytes([33])", "mine.py:12: Acme lacks urgent_stop, bytes as a literal"),
    ('accepted, refused = r"# OK", ', "refused = ", "mine.py:8: Acme lacks accepted"),
    ("def identity(", "def who(", r"mine.py:8: Acme lacks identity: \(its name, what is another"),
    ("def state(", "def status(", "mine.py:8: Acme lacks state: Its activity"),
    ("def move_line(", "def go(", "mine.py:8: Acme lacks move_line: The line that begins a move"),
    ("def state(self)", "def state(self):\n        return None\n\n    def other(self)", "mine.py:21: .*asks nothing"),
    ("class AcmeEmulator", "class Other(Acme):\n    pass\n\n\nclass AcmeEmulator", "several: Acme, Other"),
]
FAILS = [  # what stands in place of what, what is said of it once it drives
    ("found[4].split(), float) / 1e9", 'found[4].split(), float) / ""', r"mine.py:24: Acme.state fails: \w*TypeError"),
    ("np.array(found[4].split(), float) / 1e9", "None", "mine.py:21: Acme.state gave positions None, not 6 finite"),
    ("State(found[1]", 'State("resting"', "mine.py:21: Acme.state gave the activity 'resting'; there are idle"),
    ("return found[1], found[2]", "return found[7], found[2]", "mine.py:19: Acme.identity fails: IndexError"),
    ("return found[1], found[2]", "return found[1]", "mine.py:17: Acme.identity gave str, not tuple"),
    ("1e9 * segment.target", "1e9 * segment.goal", "mine.py:27: Acme.move_line fails: AttributeError"),
    ("longest = 96", "longest = 20", "takes lines of 20 bytes, too few for b'\\d+ GO"),
]


def written(folder, old="", new=""):
    assert old in TEMPLATE
    (folder / "mine.py").write_text(TEMPLATE.replace(old, new, 1) if old else TEMPLATE)
    return f"file:{folder / 'mine.py'}"


@pytest.mark.parametrize("old, new, message", LACKS, ids=[row[2] for row in LACKS])
def test_a_file_that_lacks_something_is_refused_with_its_line(tmp_path, driven_design, old, new, message):
    controller = replace(driven_design.controller, protocol=written(tmp_path, old, new))
    with pytest.raises(FileError, match=message):
        protocol_of_controller(controller, driven_design.mechanism)


@pytest.mark.parametrize("old, new, message", FAILS, ids=[row[2] for row in FAILS])
def test_a_protocol_that_fails_names_its_file_and_line(tmp_path, driven_design, old, new, message):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, written(tmp_path, old, new))
    with pytest.raises(ControllerFault, match=message):
        driver.open()
        driver.home()
        driver.move(driver.lengths() + 1e-3)
    assert not emulator.machine.executed


def test_a_file_that_is_not_there_or_behind_a_url_is_not_run(tmp_path, driven_design):
    for place, message in ((tmp_path / "none.py", "cannot be read"), ("https://host/mine.py", "behind a URL")):
        with pytest.raises(FileError, match=message):
            protocol_of_controller(replace(driven_design.controller, protocol=f"file:{place}"), driven_design.mechanism)


def test_a_move_is_sent_once_and_a_question_again(tmp_path, driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, written(tmp_path))
    driver.open()
    driver.home()
    lines, line = [], emulator.line
    emulator.line = lambda text: (lines.append(text.split(b" ")[1]), line(text))
    emulator.faults.armed["lost-ok"] = 0
    answer = emulator.answer
    silent = iter([True, True])
    emulator.answer = lambda text: None if b"POS" in text.encode() and next(silent, False) else answer(text)
    driver.move(driver.lengths() + 1e-3)
    assert lines.count(b"GO") == 1 and lines.count(b"POS") > 3 and len(emulator.machine.executed) == 1


def test_a_restart_with_a_lost_connection_during_homing_ends_with_cause_and_remedy(tmp_path, driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, written(tmp_path))
    driver.open()

    def restart():
        emulator.power_cycle()
        emulator.unplug()

    clock.action_time, clock.action = clock.now() + 0.1, restart
    with pytest.raises(PositionLost, match=r"^unplugged; .* the controller has restarted; home it \(rig home\)"):
        driver.home()


def test_a_refused_move_shows_what_was_sent(tmp_path, driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, written(tmp_path))
    driver.open()
    driver.home()
    emulator.is_beyond_limits = lambda target: True
    with pytest.raises(
        ControllerFault, match=r"the move was refused: beyond the limits; sent: '\d+ GO 100 1000000 1000"
    ):
        driver.move(driver.lengths() + 1e-3)


@pytest.mark.parametrize(("factor", "words"), [(1e3, "too large"), (1e-3, "too small"), (1e-2, "")])
def test_lengths_in_another_unit_are_named_so(driven_design, factor, words):
    mechanism = driven_design.mechanism
    target = mechanism.strut_range.mean(axis=1)
    with pytest.raises(Unreachable, match=r"\[controller\] zero") as raised:
        require_safe_path(factor * target, target, mechanism, 0.1, None)
    assert ("units?" in str(raised.value)) == bool(words) and words in str(raised.value)
