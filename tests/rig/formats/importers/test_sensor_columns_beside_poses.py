"""A table of joint values and poses may hold temperatures: they become channels, and other columns are named."""

import numpy as np
import pytest

from rig.checks.unit_and_convention_mistakes import sensor_channel_unit_and_name_mistakes
from rig.errors import FileError, RigError
from rig.formats.importers.foreign_file_import_recipe import load_recipe, recipe_of_options, recipe_toml
from rig.formats.importers.recording_import_from_foreign_files import assemble_recording, write_recording
from rig.recording.recording_folder import Sensors, load_recording

RIG = """schema = "rig/1"
[mechanism]
kind = "arm"
joints = [[0.0, 0.3, 0.0, 1.5707963267948966], [0.0, 0.0, 0.4, 0.0], [0.0, 0.0, 0.3, 0.0]]
limits = [[-3.0, 3.0], [-2.0, 2.0], [-2.5, 2.5]]
[instrument]
base = "free"
tool = "free"
position_sigma = 2e-5
"""
COUNT = 12
Q = np.random.default_rng(2).uniform(-1.5, 1.5, (COUNT, 3))
WARM = 20 + 0.5 * np.arange(COUNT)


def table(path, **columns):
    """A table of joint values and positions with more columns {header: n texts}."""
    radius = 0.4 * np.cos(Q[:, 1]) + 0.3 * np.cos(Q[:, 1] + Q[:, 2])
    height = 0.3 + 0.4 * np.sin(Q[:, 1]) + 0.3 * np.sin(Q[:, 1] + Q[:, 2])
    p = np.stack([radius * np.cos(Q[:, 0]), radius * np.sin(Q[:, 0]), height], axis=1)
    rows = [
        [f"{20 * k + 3}", *(f"{v:.6f}" for v in (*Q[k], *p[k])), *(c[k] for c in columns.values())]
        for k in range(COUNT)
    ]
    header = ["t [s]", "q1 [rad]", "q2 [rad]", "q3 [rad]", "x [m]", "y [m]", "z [m]", *columns]
    path.write_text("\n".join(",".join(row) for row in (header, *rows)) + "\n")
    return path


def sensors_of_own_table(folder, *headers):
    """ImportedRecording with channels of a table of sensors of their own, each with the values of WARM."""
    (folder / "rig.toml").write_text(RIG)
    rows = [[f"{20 * k + 3}", *[f"{WARM[k]}"] * len(headers)] for k in range(COUNT)]
    (folder / "warm.csv").write_text("\n".join(",".join(row) for row in (["t [s]", *headers], *rows)) + "\n")
    data = table(folder / "data.csv")
    files = {"commands": data, "poses": data, "sensors": folder / "warm.csv"}
    return assemble_recording(recipe_of_options(folder / "rig.toml", [], files, ()))


def imported(folder, settings=(), **columns):
    (folder / "rig.toml").write_text(RIG)
    data = table(folder / "data.csv", **columns)
    recipe = recipe_of_options(folder / "rig.toml", [], {"commands": data, "poses": data}, tuple(settings))
    return assemble_recording(recipe)


@pytest.mark.parametrize(
    "header, name",
    [
        ("arm_temp_C", "ambient_temperature_C"),
        ("Temperature [C]", "ambient_temperature_C"),
        ("T_room [K]", "ambient_temperature_C"),
        ("joint 2 temperature [C]", "joint2_temperature_C"),
        ("gearbox temp [C]", "gearbox_temperature_C"),
    ],
)
def test_a_temperature_beside_poses_is_a_channel(tmp_path, header, name):
    shift = 273.15 if "[K]" in header else 0.0
    done = imported(tmp_path, **{header: [f"{v + shift:.2f}" for v in WARM]})
    out = tmp_path / "out"
    out.mkdir()
    write_recording(done, out)
    sensors = load_recording(out).sensors
    assert list(sensors.channels) == [name]
    np.testing.assert_allclose(sensors.channels[name], WARM, atol=1e-9)
    np.testing.assert_allclose(np.diff(sensors.t), 20.0)
    assert any(name in line for line in done.remarks)


def test_a_recipe_repeats_its_channels(tmp_path):
    done = imported(
        tmp_path, ["sensors.columns.load_A=Motor"], Motor=["1.5"] * COUNT, arm_temp_C=[f"{v}" for v in WARM]
    )
    (tmp_path / "recipe.toml").write_text(recipe_toml(done.recipe, tmp_path))
    again = assemble_recording(load_recipe(tmp_path / "recipe.toml"))
    for logged in (done.logged, again.logged):
        assert [name for name, _ in logged.channels] == ["load_A", "ambient_temperature_C"]
    assert not any("not read" in line for line in again.remarks)


def test_other_columns_are_named_with_what_reads_them(tmp_path):
    words = ["warm"] * COUNT
    done = imported(tmp_path, Motor=["1.5"] * COUNT, arm_temp_C=words)
    assert done.logged is None
    (line,) = [line for line in done.remarks if "not read" in line]
    assert (
        "Motor" in line and "arm_temp_C (line 2 has no number)" in line and "--set sensors.columns.NAME=Motor" in line
    )
    with pytest.raises(FileError, match="arm_temp_C"):
        imported(tmp_path, ["sensors.columns.ambient_temperature_C=arm_temp_C"], arm_temp_C=words)


def test_two_temperatures_of_a_machine_are_not_both_its_room(tmp_path):
    warm = [f"{v}" for v in WARM]
    done = imported(tmp_path, arm_temp_C=warm, room_temp_C=warm)
    assert [name for name, _ in done.logged.channels] == ["arm_temperature_C", "ambient_temperature_C"]


def test_a_temperature_that_no_effect_follows_is_named_in_a_recording(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    design = imported(tmp_path).design
    (found,) = sensor_channel_unit_and_name_mistakes(Sensors(20.0 * np.arange(COUNT), {"arm_temp_C": WARM}), design)
    assert "arm_temp_C" in found.what and "ambient_temperature_C" in found.do and "joint1_temperature_C" in found.do


@pytest.mark.parametrize(
    "name, is_named",
    [
        *((name, False) for name in ("attempts", "template_score", "contempt", "temp_setpoint_C", "target_temp")),
        *((name, True) for name in ("temp", "spindle_temp_C", "Temperature", "temp_1", "motor_temp2_C")),
    ],
)
def test_a_temperature_is_a_whole_word_of_a_name_and_no_setpoint(tmp_path, name, is_named):
    (tmp_path / "rig.toml").write_text(RIG)
    log = Sensors(20.0 * np.arange(COUNT), {name: WARM})
    found = list(sensor_channel_unit_and_name_mistakes(log, imported(tmp_path).design))
    assert bool(found) == is_named and all(name in one.what for one in found)


def test_a_table_of_sensors_keeps_its_names(tmp_path):
    """But for a temperature that is the machine's or a joint's by its name, which is reported."""
    done = sensors_of_own_table(tmp_path, "spindle temp [C]", "Temperature [C]", "temp setpoint [C]", "arm temp [C]")
    names = [name for name, _ in done.logged.channels]
    assert names == ["spindle_temp_C", "Temperature_C", "temp_setpoint_C", "ambient_temperature_C"]
    assert any("arm temp [C] is ambient_temperature_C" in line for line in done.remarks)


@pytest.mark.parametrize("header, name", [("acc_x [g]", "acc_x_g"), ("accelZ (g)", "accelZ_g"), ("ay_g", "ay_g")])
def test_g_of_an_acceleration_is_no_gram(tmp_path, header, name):
    done = sensors_of_own_table(tmp_path, header, "payload [g]", "load a [g]")
    channels = dict(done.logged.channels)
    np.testing.assert_allclose(channels[name], WARM)
    np.testing.assert_allclose([channels["payload_mass_kg"], channels["load_a_kg"]], [WARM / 1000] * 2)
    assert any(f"{header} is {name}, not converted" in line for line in done.remarks)


def test_a_setpoint_beside_poses_is_not_the_temperature_of_the_machine(tmp_path):
    done = imported(tmp_path, **{"temp setpoint [C]": [f"{v}" for v in WARM]})
    assert [name for name, _ in done.logged.channels] == ["temp_setpoint_C"]


def test_rows_of_sensors_are_not_stated(tmp_path):
    with pytest.raises(RigError, match="sensors.rows=held states what rows are, and only commands.rows does"):
        imported(tmp_path, ["sensors.rows=held"], arm_temp_C=[f"{v}" for v in WARM])
