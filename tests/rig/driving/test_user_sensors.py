"""Sensors or an instrument of the user's own: readings at rest, named where they fail."""

import pytest

from rig.driving.driving_clock import SimulatedClock
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import (
    open_sensors_of_rig_toml,
    refuse_programs_of_untrusted_rig_toml,
)
from rig.errors import FileError, NoAnswer, RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import SensorPort
from tests.rig.driving.test_user_programs import stated

FILE = '''"""A gauge."""

from rig.driving.base import UserSensors


class Gauge(UserSensors):
    count = 0

    def read(self):
        self.count += 1
        return {"gauge": 0.5 * self.count, "air": 20}
'''
WRONG = [
    ("def read(", "def look(", FileError, "gauge.py:6: Gauge lacks read"),
    ("(UserSensors)", "", FileError, r"defines no sensors: class Mine\(UserSensors\)"),
    ("self.count += 1", "self.count / 0", NoAnswer, "gauge.py:10: Gauge.read fails: ZeroDivisionError"),
    ('"air": 20', '"water": 20', NoAnswer, "Gauge.read gave no number for air"),
    ("20}", "float('nan')}", NoAnswer, "Gauge.read gave no number for air"),
]


def port(folder, text):
    (folder / "gauge.py").write_text(text)
    return SensorPort(f"file:{folder / 'gauge.py'}", 115200, "", ("gauge", "air"))


def test_readings_come_in_the_order_of_the_channels(tmp_path):
    reader = open_sensors_of_rig_toml(port(tmp_path, FILE), SimulatedClock())
    assert [reader.read(), reader.read()] == [{"gauge": 0.5, "air": 20.0}, {"gauge": 1.0, "air": 20.0}]
    reader.close()


@pytest.mark.parametrize("old, new, kind, message", WRONG)
def test_what_is_wrong_is_named(tmp_path, old, new, kind, message):
    assert old in FILE
    with pytest.raises(kind, match=message):
        open_sensors_of_rig_toml(port(tmp_path, FILE.replace(old, new, 1)), SimulatedClock()).read()


def test_a_program_of_sensors_is_not_run_from_a_recording(tmp_path):
    path = stated(tmp_path / "rec", protocol="struts")
    path.write_text(path.read_text() + '\n[sensors]\nport = "file:gauge.py"\nchannels = ["gauge"]\n')
    design = design_from_rig_toml.load_design(path)
    assert design.sensors.port == f"file:{tmp_path}/rec/gauge.py"
    refuse_programs_of_untrusted_rig_toml(path, design)
    (tmp_path / "rec" / "frames.csv").touch()
    with pytest.raises(RigError, match="part of a recording"):
        refuse_programs_of_untrusted_rig_toml(path, design)
