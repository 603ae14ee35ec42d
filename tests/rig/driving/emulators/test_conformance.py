"""Conformance: every protocol passes; one that is unsafe fails at what is unsafe in it."""

import re

import pytest

from rig.cli.command_line import main
from rig.driving.cameras import open_camera
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators.protocol_conformance_checks_against_emulator import (
    check_protocol_conformance,
    protocol_conformance_design,
)
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import open_sensors_of_rig_toml
from rig.model.design import SensorPort
from tests.conftest import ROOT
from tests.rig.conftest import EVERY_PROTOCOL
from tests.rig.driving.cameras.test_cameras import camera
from tests.rig.driving.protocols.test_user_protocol import TEMPLATE, written

LONG = ("gcs-hexapod", "epics", "epics-hexapod", "gcs", "linuxcnc")  # those that take the most seconds
UNSAFE = {  # what stands in place of what, which check fails
    "its stop bytes do nothing": ('urgent_stop = b"!"', 'urgent_stop = b"?"', "stops while it moves"),
    "it hides an axis in error": ('"" if found[3] == "ok" else found[3]', '""', "done-in-error"),
    "its stop is another line": ('"# STOP", ', '"# WHO", ', "homes-on"),
    "it asks again by a move": (
        "    def move_line(self",
        "    def move(self, segment):\n        found = yield from self.ask(self.move_line(segment), self.accepted)\n"
        "        return Verdict(bool(found))\n\n    def move_line(self",
        "runs-after-error",
    ),
    "its positions are in another unit": ("float) / 1e9", "float) / 1e6", "greets, homes and moves"),
    "it waits without an end": (
        "    def move_line(self",
        "    def stop(self):\n        while True:\n            yield from self.ask(self.stop_line, self.accepted)\n\n"
        "    def move_line(self",
        "stops while it moves",
    ),
    "a refusal does not fit": (r'r"# NO (.*)"', r'r"# NO (.*) !"', "a move before homing"),
    "its emulator begins moves itself": (
        "return self.move(1e-9 * np.array(target), milliseconds / 1e3, yes, no)",
        "self.machine.go(self.now, 1e-9 * np.array(target), milliseconds / 1e3)\n            return yes",
        "lost-ok",
    ),
}


@pytest.fixture(scope="module")
def hexapod():
    return protocol_conformance_design(None)


@pytest.mark.parametrize("protocol", [pytest.param(p, marks=[pytest.mark.slow] * (p in LONG)) for p in EVERY_PROTOCOL])
def test_every_protocol_passes(hexapod, protocol):
    checks = list(check_protocol_conformance(hexapod, protocol, 100))
    assert len(checks) == 28 and [(check.name, check.problem) for check in checks if check.problem] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", UNSAFE)
def test_an_unsafe_protocol_fails_where_it_is_unsafe(tmp_path, hexapod, name):
    old, new, check = UNSAFE[name]
    stated = written(tmp_path, old, new)
    if "Verdict" in new:
        path = tmp_path / "mine.py"
        path.write_text(path.read_text().replace("Segment, State", "Segment, State, Verdict"))
    tried = {}
    for found in check_protocol_conformance(hexapod, stated, 100):
        tried[found.name.partition(":")[0]] = found.problem
        if check in tried:
            break
    assert tried[check], tried


@pytest.mark.slow
def test_a_new_protocol_is_written_and_tested(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["emulate", "--new", "mine"]) == 0
    assert (tmp_path / "mine.py").read_text() == TEMPLATE and len(TEMPLATE.splitlines()) <= 60
    assert main(["emulate", "--conform", "--protocol", "mine.py", "--moves", "20"]) == 0
    assert "all 28 checks passed" in capsys.readouterr().out
    (tmp_path / "bad.py").write_text(TEMPLATE.replace('urgent_stop = b"!"', 'urgent_stop = b"?"'))
    assert main(["emulate", "--conform", "--protocol", "bad.py", "--moves", "20"]) == 1
    output = capsys.readouterr()
    assert "FAILED  stops while it moves: urgent_stop did not slow" in output.out and "checks failed" in output.err


def test_the_page_shows_the_file_that_is_written_and_a_camera_that_works(tmp_path):
    page = (ROOT / "docs" / "own-protocols.md").read_text(encoding="utf-8")
    protocol, camera_file, sensors_file = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert protocol == TEMPLATE
    (tmp_path / "cam.py").write_text(camera_file)
    assert (open_camera(camera(f"file:{tmp_path}/cam.py"), SystemClock()).grab().image == 128).all()
    (tmp_path / "gauge.py").write_text(sensors_file)
    stated = SensorPort(f"file:{tmp_path}/gauge.py", 115200, "", ("gauge", "air_temperature_C"))
    assert open_sensors_of_rig_toml(stated, SystemClock()).read() == {"gauge": 0.0012, "air_temperature_C": 20.4}


def test_a_protocol_is_given_by_its_option_and_written_by_either_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["emulate", "--new", "mine.py"]) == 0 and (tmp_path / "mine.py").read_text() == TEMPLATE
    assert main(["emulate", "--conform", "mine.py"]) == 1
    assert "mine.py is a protocol: it is given by --protocol mine.py" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--conform"], [], ["--new", "a b"], ["--conform", "--protocol", "grbhal"]])
def test_what_cannot_be_meant_is_refused(words, capsys):
    assert main(["emulate", *words]) == 1 and "rig emulate: " in capsys.readouterr().err
