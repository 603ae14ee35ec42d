"""Tables of instruments that measure a part of the pose, and of machines of an owner's own kinematics."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from rig.errors import FileError, RigError
from rig.formats.importers import foreign_file_import_recipe as import_recipe
from rig.formats.importers import recording_import_from_foreign_files as recording_import
from rig.formats.importers.foreign_sensor_table import read_sensors
from rig.formats.local_and_remote_input_files import open_regular_file
from rig.model.mechanisms import hexapod
from rig.model.pose import exp
from rig.planning.configuration_generators import evenly_spread_configurations
from rig.recording.recording_folder import load_recording
from tests.calib.checks.test_mistakes import run_in_process
from tests.conftest import BENCH

ARM = """schema = "rig/1"
[mechanism]
kind = "arm"
joints = [[0.0, 0.3, 0.0, 1.5707963], [0.0, 0.0, 0.4, 0.0]]
limits = [[-3.0, 3.0], [-1.5, 1.5]]
"""
INSTRUMENT = '[instrument]  # a tracker\nbase = "free"\ntool = "free"\n'
LEVEL = """import math
import numpy as np
from rig.model.mechanisms import Axis, Parameter

axes = (Axis("th1", "rad", -1.5, 1.5), Axis("lift", "m", 0.0, 0.3))
parameters = (Parameter("arm", 0.2, "m", 1e-3),)
freedoms = ("x", "z")
home = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)


def inverse(pose, p):
    return np.array([math.asin(pose[0, 3] / p["arm"]), pose[2, 3]])
"""


def imported(folder, rig, commands, poses, *settings):
    """Recording of two tables as `rig import` makes it, and what it says."""
    for name, text in (("rig.toml", rig), ("robot.csv", commands), ("tracker.csv", poses)):
        (folder / name).write_text(text)
    status, text = run_in_process(
        *("import", "--rig", folder / "rig.toml", "--commands", folder / "robot.csv"),
        *("--poses", folder / "tracker.csv", "--out", folder / "rec"),
        *(word for setting in settings for word in ("--set", setting)),
    )
    return SimpleNamespace(status=status, text=text, recording=load_recording(folder / "rec") if not status else None)


JOINTS = "t,q1 [deg],q2 [deg]\n" + "".join(f"{k},{10 * k},{-5 * k}\n" for k in range(8))
POINTS = "t,x [mm],y [mm],z [mm]\n" + "".join(f"{k},{300 + k},{20 * k},{400 - k}\n" for k in range(8))


def test_positions_alone_leave_no_rotation_sigma(tmp_path):
    """A reflector's positions are not read as poses without rotation, whatever rig.toml states of its instrument."""
    stated = ARM + INSTRUMENT + "position_sigma = 2e-5\nrotation_sigma = 1e-4  # rad\n"
    found = imported(tmp_path, stated, JOINTS, POINTS)
    assert found.status == 0 and "rotation_sigma is left out" in found.text, found.text
    assert found.recording.design.instrument.rotation_sigma is None
    text = (tmp_path / "rec" / "rig.toml").read_text()
    assert text == stated.replace("rotation_sigma = 1e-4  # rad\n", "")
    np.testing.assert_allclose(found.recording.poses.T_base_platform.translation[3], [0.303, 0.06, 0.397])


def test_positions_alone_without_an_instrument_are_refused(tmp_path):
    found = imported(tmp_path, ARM, JOINTS, POINTS)
    assert found.status and "no columns of rotations" in found.text, found.text


@pytest.mark.parametrize(
    "header, scale",
    [("UTC,Az (deg),El (deg)", 180 / np.pi), ("t,azimuth,elevation", 180 / np.pi), ("t,az_rad,alt_rad", 1.0)],
)
def test_directions_and_their_mount(tmp_path, header, scale):
    """Azimuth and elevation head the columns of the mount's commands and of the stars."""
    angles = np.radians([[0.0 + 45 * k, 20.0 + 8 * k] for k in range(8)])
    rows = "".join(f"{k},{scale * a:.9f},{scale * e:.9f}\n" for k, (a, e) in enumerate(angles))
    rig = ARM.replace("[-3.0, 3.0], [-1.5, 1.5]", "[0.0, 6.28], [0.0, 1.5]")
    rig += INSTRUMENT + 'kind = "direction"\nrotation_sigma = 1e-5\n'
    found = imported(tmp_path, rig, f"{header}\n{rows}", f"{header}\n{rows}")
    assert found.status == 0, found.text
    seen = found.recording.poses.T_base_platform.rotation.as_matrix()[:, :, 2]
    a, e = angles.T
    np.testing.assert_allclose(seen, np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)], 1), atol=1e-8)
    np.testing.assert_allclose(found.recording.commanded()[2], angles, atol=1e-8)


def test_distances(tmp_path):
    rig = ARM + INSTRUMENT + 'kind = "distance"\nposition_sigma = 1e-5\n'
    poses = "t,wire [mm]\n" + "".join(f"{k},{700 + k}\n" for k in range(8))
    found = imported(tmp_path, rig, JOINTS, poses)
    assert found.status == 0, found.text
    np.testing.assert_allclose(found.recording.poses.T_base_platform.translation[:, 0], 0.7 + 1e-3 * np.arange(8))
    assert "unit of its distances" in imported(tmp_path, rig, JOINTS, poses.replace(" [mm]", "")).text


def test_axes_of_a_kinematics_file(tmp_path, recwarn):
    """Its own names with units behind them, angles in degrees and slides in mm by their travel; no warning of numpy."""
    (tmp_path / "level.py").write_text(LEVEL)
    rig = 'schema = "rig/1"\n[mechanism]\nkind = "file:level.py"\n' + INSTRUMENT.replace("free", "rig")
    rig += "position_sigma = 1e-5\nrotation_sigma = 1e-4\n"
    for header in ("t,th1_deg,lift_mm", "t,th1,lift"):
        rows = "".join(f"{k},{10 * k - 35},{30 * k}\n" for k in range(8))
        found = imported(tmp_path, rig, f"{header}\n{rows}", POINTS)
        assert found.status == 0, found.text
        np.testing.assert_allclose(found.recording.commanded()[2][2], [np.radians(-15), 0.06], atol=1e-12)
        shutil.rmtree(tmp_path / "rec")
        (tmp_path / "rec.import.toml").unlink()
    assert not [one for one in recwarn if "omplex" in str(one.message)]


def test_rows_of_several_reflectors_ask_for_hands(tmp_path):
    """Three rows of a time are three reflectors; stated as hands of one joint they are read."""
    points = "t,reflector,x [mm],y [mm],z [mm]\n"
    points += "".join(f"{k},SMR{i},{300 + k},{20 * k},{400 - k + 9 * i}\n" for k in range(8) for i in (1, 2))
    stated = INSTRUMENT + "position_sigma = 2e-5\n"
    found = imported(tmp_path, ARM + stated, JOINTS, points)
    assert found.status and "8 of 16 rows have the time of another" in found.text and "hand=HEADER" in found.text
    assert "tracker.csv:3: t 0 is in line 2 as well" in found.text
    hands = "".join(f'[[mechanism.hand]]\nname = "SMR{i}"\njoint = 2\n' for i in (1, 2))
    found = imported(tmp_path, ARM + hands + stated, JOINTS, points, "poses.columns.hand=reflector")
    assert found.status == 0 and len(found.recording.poses.frame) == 16, found.text


LINE_6 = "4,304,80,396"
DIRTY = {
    "a decimal comma in one row": (
        POINTS.replace(",", ";"),
        "4;304;80",
        "4;304.5;80,5",
        ":6: '4;304.5;80,5;396' is not as 7 of 8 rows",
    ),
    "a cell too many": (POINTS, LINE_6, f"{LINE_6},7", f":6: '{LINE_6},7' is not as 7 of 8 rows, of 4 cells"),
    "half a last line": (POINTS, ",140,393\n", ",1", ":9: its last line is not like the 7 before it"),
    "two columns of one name": (POINTS, "y [mm]", "x [mm]", ": columns 2 and 3 are both named 'x [mm]'; rename"),
    "an unknown unit": (POINTS, "[mm]", "[furlong]", ": column 'x [furlong]' is in 'furlong', which is no known unit"),
    "units that differ": (POINTS, "z [mm]", "z [m]", ": x in mm, y in mm, z in m; convert them to one unit"),
    "no time in one row": (POINTS, LINE_6, LINE_6.replace("4", "four", 1), ":6:1: column 't': 'four' is not a time"),
    "dates of a country": (POINTS, "\n4,", "\n01.05.2024 10:00:04,", ":6:1: column 't': '01.05.2024 10:00:04' is not"),
    "an implausible position": (POINTS, ",304,", ",3.04e7,", ":6: a position of 30400 m is implausible"),
    "half a frame": (
        POINTS.replace("t,", "frame,"),
        LINE_6,
        f"4.5{LINE_6[1:]}",
        ":6:1: column 'frame' numbers frames, and 4.5",
    ),
    "a frame that occurs twice": (
        POINTS.replace("t,", "frame,"),
        LINE_6,
        f"3{LINE_6[1:]}",
        ":6: frame 3 is in line 5 as",
    ),
    "no row": (POINTS[: POINTS.index("\n") + 1], "", "", ":1: has no rows below its only line, 't,x [mm],y"),
    "nothing": ("", "", "", ": is empty"),
    "a NUL byte": (POINTS, LINE_6, f"{LINE_6}\0", ":6: is not text: it contains a NUL byte"),
}


@pytest.mark.parametrize("table, clean, dirty, words", DIRTY.values(), ids=DIRTY)
def test_a_dirty_table_is_named_with_line_and_value(tmp_path, table, clean, dirty, words):
    found = imported(tmp_path, ARM + INSTRUMENT + "position_sigma = 2e-5\n", JOINTS, table.replace(clean, dirty))
    assert found.status == 1 and f"tracker.csv{words}" in found.text, found.text


def test_a_table_of_excel_states_its_separator(tmp_path):
    points = f"sep=;\n{POINTS}".replace(",", ";")
    found = imported(tmp_path, ARM + INSTRUMENT + "position_sigma = 2e-5\n", JOINTS, points)
    np.testing.assert_allclose(found.recording.poses.T_base_platform.translation[3], [0.303, 0.06, 0.397])


@pytest.mark.parametrize(
    "time, words", [("0.5", "its time, 0.5 s, is before that of line 5, 3.0 s"), ("3", "two rows")]
)
def test_commands_whose_times_do_not_increase_are_named(tmp_path, time, words):
    """Though the unit of the times is not stated, and is found by how fast the joints move."""
    joints = JOINTS.replace("\n4,40", f"\n{time},40")
    found = imported(tmp_path, ARM + INSTRUMENT + "position_sigma = 2e-5\n", joints, POINTS)
    assert found.status == 1 and f"robot.csv:6: {words}" in found.text, found.text


def test_euler_angles_are_read_as_the_commands_turn(tmp_path):
    """Yaw, pitch and roll of a hexapod's platform, in the frame of an instrument that stands anywhere."""
    rng = np.random.default_rng(2)
    rig = (BENCH / "fit" / "rig.toml").read_text()
    m = load_recording(BENCH / "fit").design.mechanism
    lengths = evenly_spread_configurations(m, 16)
    real = hexapod.forward(lengths + 5e-4 * rng.normal(size=6), m)
    seen = exp(rng.normal(size=6)) * real * exp(0.3 * rng.normal(size=6))
    angles = seen.rotation.as_euler("ZYX", degrees=True)
    rows = zip(range(16), 1e3 * seen.translation, angles)
    poses = "t [s],x [mm],y [mm],z [mm],yaw [deg],pitch [deg],roll [deg]\n"
    poses += "".join(",".join([str(k), *(f"{x:.6f}" for x in (*p, *a))]) + "\n" for k, p, a in rows)
    commands = "t [s]," + ",".join(f"l{i} [m]" for i in range(1, 7)) + "\n"
    commands += "".join(",".join([str(k), *(f"{x:.9f}" for x in row)]) + "\n" for k, row in enumerate(lengths))
    rig += "\n" + INSTRUMENT + "position_sigma = 1e-5\nrotation_sigma = 4e-5\n"
    found = imported(tmp_path, rig, commands, poses, "commands.relative=zero")
    assert found.status == 0, found.text
    off = found.recording.poses.T_base_platform.rotation.inv() * seen.rotation
    assert off.magnitude().max() < 1e-6


def test_a_recipe_repeats_a_reading_by_travel(tmp_path):
    """What the travel decided is stated by the recipe where all axes share it."""
    (tmp_path / "rig.toml").write_text(ARM + INSTRUMENT + "position_sigma = 2e-5\n")
    (tmp_path / "robot.csv").write_text(JOINTS.replace(" [deg]", ""))
    (tmp_path / "tracker.csv").write_text(POINTS)
    tables = {"commands": tmp_path / "robot.csv", "poses": tmp_path / "tracker.csv"}
    recipe = import_recipe.recipe_of_options(tmp_path / "rig.toml", [], tables, ())
    made = recording_import.assemble_recording(recipe)
    assert made.recipe.commands.unit == "deg"
    (tmp_path / "robot.csv").write_text(JOINTS.replace(" [deg]", "").replace("-35", "-3500"))
    with pytest.raises(RigError, match="beyond the limits in rig.toml in rad and in deg"):
        recording_import.assemble_recording(recipe)


@pytest.mark.parametrize(
    "header, names",
    [
        ("leg temperature [°C]", [f"strut{i}_temperature_C" for i in range(1, 7)]),
        ("Bein 3 Temperatur [°C]", ["strut3_temperature_C"]),
        ("T_leg2 [C]", ["strut2_temperature_C"]),
        ("room [°C]", ["ambient_temperature_C"]),
        ("T_ambient [K]", ["ambient_temperature_C"]),
        ("L1 [°C]", ["L1_C"]),
        ("spindle temp [C]", ["spindle_temp_C"]),
    ],
)
def test_temperatures_get_the_names_by_which_they_count(tmp_path, header, names):
    """One thermometer of the legs is that of each of them: effects know the temperature of each strut."""
    path = tmp_path / "log.csv"
    path.write_text(f"t [s],{header}\n0,290\n1,291\n")
    table = import_recipe.ForeignTable(path)
    mechanism = load_recording(BENCH / "fit").design.mechanism
    read = read_sensors(table, lambda t: True, mechanism)
    assert [name for name, _ in read.channels] == names
    reread = read_sensors(read.table, lambda t: True, mechanism)  # as a recipe repeats it
    assert [name for name, _ in reread.channels] == names


def test_directions_of_two_units_and_of_none(tmp_path):
    """Each column is read in its own unit; lengths, and what is beyond the circle, are refused."""
    rig = ARM.replace("[-3.0, 3.0], [-1.5, 1.5]", "[0.0, 6.28], [0.0, 1.5]")
    rig += INSTRUMENT + 'kind = "direction"\nrotation_sigma = 1e-5\n'
    angles = [(45.0 * k, 0.3 + 0.1 * k) for k in range(8)]
    rows = "".join(f"{k},{a:.9f},{e:.9f}\n" for k, (a, e) in enumerate(angles))
    commands = "t,az [rad],el [rad]\n" + "".join(
        f"{k},{np.radians(a):.9f},{e:.9f}\n" for k, (a, e) in enumerate(angles)
    )
    found = imported(tmp_path, rig, commands, f"t,az [deg],el [rad]\n{rows}")
    assert found.status == 0, found.text
    seen = found.recording.poses.T_base_platform.rotation.as_matrix()[:, :, 2]
    np.testing.assert_allclose(-seen[:, 2], np.sin([e for _, e in angles]), atol=1e-8)
    assert "mm is not a unit of azimuth" in imported(tmp_path, rig, commands, f"t,az [mm],el [rad]\n{rows}").text
    text = imported(tmp_path, rig, commands, f"t,az [deg],el [deg]\n{rows}8,400,0.5\n").text
    assert "beyond the circle in deg" in text and "tracker.csv:10" in text and "400, 0.5" in text, text


def test_a_path_with_a_typing_error_names_the_one_that_is_there(tmp_path):
    (tmp_path / "rig.toml").write_text(ARM)
    (tmp_path / "robot.csv").write_text(JOINTS)
    (tmp_path / "images").mkdir()
    for words in (("--commands", tmp_path / "robto.csv", tmp_path / "images"), (tmp_path / "imagse",)):
        status, text = run_in_process("import", "--rig", tmp_path / "rig.toml", "--out", tmp_path / "rec", *words)
        assert status == 1 and f"is {tmp_path / ('robot.csv' if len(words) > 1 else 'images')} meant?" in text, text
    (tmp_path / "nowhere.csv").symlink_to(tmp_path / "gone")
    with pytest.raises(FileError) as error:
        open_regular_file(tmp_path / "nowhere.csv")
    assert "meant" not in str(error.value)
