"""rig.toml: what is read, and that every complaint names file, line and column."""

import numpy as np
import pytest

from rig.errors import FileError
from rig.formats.json_toml_and_yaml_loading import toml_value_positions
from rig.formats.rig_toml import camera_instrument_experiment_and_cube_turn_entries, design_from_rig_toml
from rig.model import mechanisms
from rig.model.pose import exp, pose_difference
from tests.conftest import SHARED


def spoiled(rig_text, tmp_path, old, new):
    assert old in rig_text
    path = tmp_path / "rig.toml"
    path.write_text(rig_text.replace(old, new, 1))
    return path


def test_a_whole_rig_is_read(design):
    assert design.mechanism.kind == "hexapod" and len(design.cameras) == 3 and len(design.targets) == 8
    assert design.cameras[0].matrix.shape == (3, 3) and design.gravity[2] == -9.80665
    assert sorted(n for target in design.targets for n in target.ids) == list(range(40))


@pytest.mark.parametrize(
    "old, new, says",
    [
        ('schema = "rig/1"', 'schema = "rig/2"', "written by a newer rig"),
        ('schema = "rig/1"', 'schema = "robot/1"', "is no rig.toml"),
        ('kind = "hexapod"', 'kind = "hexpod"', "hexpod"),
        ('kind = "hexapod"', "kind = 6", "must be text"),
        ("distortion", "distorsion", "'distortion' meant"),
        ("width = 1280", 'width = "wide"', "whole number"),
        ("width = 1280", "width = 0", "at least 1"),
        ("edge = 0.093", "edge = 93.0", "millimetres"),
        ('"-x" = 1', '"-x" = 0', "already belongs"),
        ('"-x" = 1', '"-q" = 1', "no face"),
        ('"-x" = 1', '"-x" = 1000', "DICT_5X5_100 has identities"),
        ('name = "P2"', 'name = "P1"', "listed twice"),
        ('name = "cam1"', 'name = "cam0"', "listed twice"),
        ('body = "platform"', 'body = "plattform"', "plattform"),
        ("[-0.1, 0.08, 0.0, 0.0, 0.0]", "[-0.1, 0.08, 0.0]", "4, 5, 8, 12, 14 terms"),
        ("[-0.1, 0.08, 0.0, 0.0, 0.0]", "[-0.1, nan, 0.0, 0.0, 0.0]", "not finite"),
        ("screw_lead = 0.004", "screw_lead = -1", "> 0"),
        ('shutter = "global"', 'shutter = "rolling"\nrow_time = 2.0', "must be >= -1 and <= 1 s"),
        ("[mechanism]", "[mechanics]", "mechanism"),
        ("[mechanism]", "[mechanism", "not valid TOML"),
    ],
)
def test_every_fault_names_its_place(rig_text, tmp_path, old, new, says):
    path = spoiled(rig_text, tmp_path, old, new)
    with pytest.raises(FileError, match=says) as caught:
        design_from_rig_toml.load_design(path)
    assert caught.value.path == str(path)
    assert caught.value.line is not None and caught.value.column is not None
    line = path.read_text().splitlines()[caught.value.line - 1]
    assert new.split("=")[0].strip(' "[]')[:4] in line or "row_time" in line or caught.value.line == 1 or "TOML" in says


def test_millimetres_are_recognised(rig_text, tmp_path):
    path = tmp_path / "rig.toml"
    scaled = rig_text.replace("base_joints = [[0.", "base_joints = [[300 , 0.0, 0.0], [0.", 1)
    path.write_text(scaled)
    with pytest.raises(FileError, match=r"base_joints must have 6x3 numbers"):
        design_from_rig_toml.load_design(path)
    path.write_text(rig_text.replace("position = [0.0, 0.0, 0.45]", "position = [0.0, 0.0, 450.0]", 1))
    with pytest.raises(FileError, match=r"metres.*millimetres \(0.45 m\)") as caught:
        design_from_rig_toml.load_design(path)
    assert "450" in path.read_text().splitlines()[caught.value.line - 1][caught.value.column - 1 :]


def test_a_home_outside_the_strut_range_is_refused(rig_text, tmp_path):
    with pytest.raises(FileError, match="home needs strut 1"):
        design_from_rig_toml.load_design(
            spoiled(rig_text, tmp_path, "position = [0.0, 0.0, 0.45]", "position = [0.0, 0.0, 0.65]")
        )


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        design_from_rig_toml.load_design(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    "above, line, says",
    [
        ('shutter = "global"', 'shuter = "rolling"', "unknown key 'camera.1.shuter'; is 'shutter' meant"),
        ("[actuator]", "screw_led = 0.002", "unknown key 'actuator.screw_led'; is 'screw_lead' meant"),
        ("[environment]", "gravitation = [0, 0, -9.8]", "unknown key 'environment.gravitation'; is 'gravity' meant"),
        ("[actuator]", 'colour = "blue"', "unknown key 'actuator.colour'; there are screw_lead, joints, max_speed"),
        ('schema = "rig/1"', "why = 1", "unknown key 'why'; there are schema, units, name"),
        ("[[target]]", 'colour = "blue"', "unknown key 'target.1.colour'"),
        ("[mechanism]", "strut_ranges = 1", "unknown key 'mechanism.strut_ranges'; is 'strut_range' meant"),
        ("[mechanism]", '"\\u001b[2J" = 1', r"unknown key 'mechanism.\\x1b\[2J'"),
    ],
)
def test_unknown_keys_are_refused_with_their_line_and_the_nearest_that_is_known(rig_text, tmp_path, above, line, says):
    assert above in rig_text
    path = spoiled(rig_text, tmp_path, above, f"{above}\n{line}")
    with pytest.raises(FileError, match=says) as caught:
        design_from_rig_toml.load_design(path)
    assert path.read_text().splitlines()[caught.value.line - 1] == line


def test_unknown_keys_of_poses_and_listed_markers_are_refused(tmp_path):
    path = tmp_path / "rig.toml"
    text = (
        'schema = "rig/1"\n[mechanism]\nkind = "free"\n[[target]]\nname = "t"\nbody = "base"\ndictionary = '
        '"DICT_APRILTAG_36h11"\n'
        "[[target.marker]]\nid = 3\nside = 0.1\npose = { position = [0, 0, 0], rotvec = [0, 0, 0] }\n"
    )
    for edit, says in (
        (("rotvec", "quaternion"), "unknown key 'target.1.marker.1.pose.quaternion'; there are position, rotvec"),
        (("side = 0.1", "side = 0.1\nmargn = 0"), "'margin' meant"),
        (('name = "t"', 'name = "t"\nedge = 0.1'), "target.1.edge"),
        (('"free"', '"free"\njoints = []'), "mechanism.joints"),
    ):
        path.write_text(text.replace(*edit))
        with pytest.raises(FileError, match=says):
            design_from_rig_toml.load_design(path)


def test_other_kinds_are_read(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = [[0, 0.1, 0, 1.57], [0.0, 0, -0.6, '
        "0]]\nlimits = [[-6, 6], [-6, 6]]\n"
        '[instrument]\nbase = "free"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 1e-4\n'
    )
    arm = design_from_rig_toml.load_design(path)
    assert arm.mechanism.axes == ("q1", "q2") and arm.instrument.base == "free"
    path.write_text(
        'schema = "rig/1"\n[mechanism]\nkind = "planar2"\nbase_joints = [[0, 0], [1, 0]]\nstrut_range = '
        "[[0.5, 1], [0.5, 1]]\n"
    )
    assert design_from_rig_toml.load_design(path).mechanism.axes == ("l1", "l2")
    path.write_text(
        'schema = "rig/1"\n[mechanism]\nkind = "free"\n[[target]]\nname = "t"\nbody = "base"\ndictionary = '
        '"DICT_APRILTAG_36h11"\n'
        "[[target.marker]]\nid = 3\nside = 0.1\npose = { position = [0, 0, 0], rotvec = [0, 0, 0] }\n"
    )
    assert design_from_rig_toml.load_design(path).targets[0].ids == (3,)


@pytest.mark.parametrize(
    "edit, says",
    [
        (("limits = [[-6, 6]]", "limits = [[6, -6]]"), "small to large"),
        (("[0, 0.1, 0, 1.57]", "[0, 127.3, 0, 1.57]"), "millimetres"),
        (("[0, 0.1, 0, 1.57]", "[0, 0.1, 0]"), "4 numbers, .*got 3"),
        (("[0, 0.1, 0, 1.57]", '["prismatik", 0, 0.1, 0, 1.57]'), "'prismatik'; is 'prismatic' meant"),
        (("[0, 0.1, 0, 1.57]", '["prismatic", 0, 0.1, 0]'), "4 numbers, .*got 3"),
        (("[0, 0.1, 0, 1.57]", '["prismatic", 0, 127.3, 0, 1.57]'), "millimetres"),
        (
            ("[0, 0.1, 0, 1.57]]\nlimits = [[-6, 6]]", '["prismatic", 0, 0.1, 0, 1.57]]\nlimits = [[0, 600]]'),
            "millimetres",
        ),
        (("[0, 0.1, 0, 1.57]", '[0, "prismatic", 0.1, 0]'), "must be a number"),
    ],
)
def test_an_arms_faults_name_their_place(tmp_path, edit, says):
    text = 'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = [[0, 0.1, 0, 1.57]]\nlimits = [[-6, 6]]\n'
    with pytest.raises(FileError, match=says) as caught:
        design_from_rig_toml.load_design(spoiled(text, tmp_path, *edit))
    assert caught.value.line in (4, 5)


def test_cameras_are_written_back_and_all_else_stays(rig_text, design, tmp_path):
    from dataclasses import replace

    moved = replace(
        design.cameras[1],
        pose=design.cameras[1].pose * exp(np.full(6, 1e-3)),
        distortion=np.array([-0.11, 0.07, 1e-4, 2e-4, 0.3]),
    )
    text = camera_instrument_experiment_and_cube_turn_entries.rig_toml_with_camera_values_replaced(
        "# keep me\n" + rig_text, [moved]
    )
    path = tmp_path / "rig.toml"
    path.write_text(text)
    loaded = design_from_rig_toml.load_design(path)
    np.testing.assert_allclose(loaded.cameras[1].distortion, moved.distortion)
    assert np.abs(pose_difference(loaded.cameras[1].pose, moved.pose)).max() < 1e-8
    assert text.startswith("# keep me") and "# camera in base" in text
    assert (
        camera_instrument_experiment_and_cube_turn_entries.rig_toml_with_camera_values_replaced(rig_text, [])
        == rig_text
    )


def test_positions_point_at_the_values(rig_text):
    lines = rig_text.splitlines()
    found = toml_value_positions(rig_text)
    places = {
        ("camera", 1, "name"): '"cam1"',
        ("target", 3, "faces", "+z"): "19",
        ("mechanism", "home", "rotvec"): "[0.0, 0.0, 0.0]",
    }
    for path, text in places.items():
        line, column = found[path]
        assert lines[line - 1][column - 1 :].startswith(text)


def test_positions_survive_odd_toml():
    text = (
        'a.b = """x\n]]"""  # c\n[t]\n"k e" = [ # why\n  1, \'two\', { y = 3 },\n]\n[[u.v]]\nw = 1979-05-27 '
        "07:32:00\n[[u.v]]\nw = -1e-3\n"
    )
    found = toml_value_positions(text)
    assert (
        found[("a", "b")] == (1, 7) and found[("t", "k e", 2, "y")] == (5, 19) and found[("u", "v", 1, "w")] == (10, 5)
    )


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the shared recordings beside the project")
@pytest.mark.parametrize("path", sorted(SHARED.glob("recordings/*/rig.toml")), ids=lambda p: p.parent.name)
def test_every_shared_rig_is_read(path):
    design_from_rig_toml.load_design(path)


@pytest.mark.parametrize(
    ("turns", "says"),
    [
        ((0.0,) * 6, "singular by its architecture"),
        ((0.2,) * 6, "singular by its architecture"),
        ((0.3, -0.3) * 3, None),
    ],
)
def test_similar_hexagons_are_said_to_be_what_they_are(tmp_path, turns, says):
    def plate(radius, turned):
        angles = np.radians([0, 60, 120, 180, 240, 300]) + turned
        return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(6)], axis=1).round(9).tolist()

    path = tmp_path / "rig.toml"
    path.write_text(
        f'schema = "rig/1"\n[mechanism]\nkind = "hexapod"\nbase_joints = {plate(0.3, 0.0)}\nplatform_joints '
        f"= {plate(0.15, turns)}\n"
        f"strut_range = {[[0.2, 0.9]] * 6}\nhome = {{ position = [0, 0, 0.4], rotvec = [0, 0, 0] }}\n"
    )
    if says is None:
        assert design_from_rig_toml.load_design(path).mechanism.kind == "hexapod"
        return
    with pytest.raises(FileError, match=says):
        design_from_rig_toml.load_design(path)


def test_rows_say_which_joints_slide(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = [["revolute", 0, 0.1, 0, 1.57], ["prismatic", '
        "0.1, 0.2, 0, 0],\n"
        "          [0.2, 0, 0.3, 0]]\nlimits = [[-6, 6], [0, 0.5], [-1, 1]]\n"
    )
    by_row = path.read_text()
    tables = [
        ("revolute", 0, 0.1, 0, 1.57, [-6, 6]),
        ("prismatic", 0.1, 0.2, 0, 0, [0, 0.5]),
        ("revolute", 0.2, 0, 0.3, 0, [-1, 1]),
    ]
    path.write_text(
        by_row.split("joints")[0]
        + "".join(
            f'[[mechanism.joints]]\njoint = "{word}"\ntheta = {theta}\nd = {d}\na = {a}\nalpha = '
            f"{alpha}\nlimits = {limits}\n"
            for word, theta, d, a, alpha, limits in tables
        )
    )
    arm, same = design_from_rig_toml.load_design(path).mechanism, path.read_text()
    path.write_text(by_row)
    of_rows = design_from_rig_toml.load_design(path).mechanism
    for name in ("rows", "limits", "slides"):
        np.testing.assert_array_equal(getattr(arm, name), getattr(of_rows, name))
    for change, says in (
        (("prismatic", "prismatik"), "joints.2.joint must be one of"),
        (("theta = 0.1", "tetha = 0.1"), "is 'tetha' meant"),
        (("d = 0.2", "d = 200"), "millimetres"),
        (("[0, 0.5]", "[0.5, 0]"), "small to large"),
    ):
        path.write_text(same.replace(*change, 1))
        with pytest.raises(FileError, match=says) as error:
            design_from_rig_toml.load_design(path)
        assert error.value.line is not None
    assert (
        arm.slides.tolist() == [False, True, False]
        and mechanisms.axis_units(arm) == ("rad", "m", "rad")
        and arm.axes == ("q1", "q2", "q3")
    )
    assert arm.rows[1].tolist() == [0.1, 0.2, 0, 0, 0] and mechanisms.axis_place_texts(arm) == (
        "joint 1",
        "slide 2",
        "joint 3",
    )


def test_tilt_sensors_need_gravity(tmp_path):
    text = '\nschema = "rig/1"\n[environment]\ngravity = [0, 0, -9.8]\n[mechanism]\nkind = "free"\n'
    text += '[[tilt_sensor]]\nname = "level"\nlink = 1\nsigma = 1e-4\n'
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert design_from_rig_toml.load_design(path).tilt_sensors[0].name == "level"
    path.write_text(text.replace("-9.8", "0"))
    with pytest.raises(FileError, match="angles against gravity, and .* gravity is 0"):
        design_from_rig_toml.load_design(path)
