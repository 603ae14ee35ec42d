"""Poses of rig.toml: a rotation as a vector, as a point looked at, or as Euler angles with their order."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig.errors import FileError
from rig.formats.rig_toml.design_from_rig_toml import load_entries


def entries(tmp_path, text):
    file = tmp_path / "rig.toml"
    file.write_text(f"pose = {{ position = [1.0, 2.0, 3.0], {text} }}\n")
    return load_entries(file)


def test_a_camera_that_looks_at_a_point_has_it_in_the_middle_and_up_in_its_image(tmp_path):
    T = entries(tmp_path, "look_at = [0.2, 0.1, 0.4]").pose("pose")
    x, y, z = T.inv().apply([0.2, 0.1, 0.4])
    assert abs(x) < 1e-12 and abs(y) < 1e-12 and z == pytest.approx(np.linalg.norm([0.8, 1.9, 2.6]))
    above = T.inv().apply([0.2, 0.1, 0.5])
    assert abs(above[0]) < 1e-12 and above[1] < 0  # image rows count downwards
    assert np.linalg.det(T.rotation.as_matrix()) == pytest.approx(1)
    aside = entries(tmp_path, "look_at = [0.2, 0.1, 0.4], up = [1.0, 0.0, 0.0]").pose("pose")
    assert aside.inv().apply([0.3, 0.1, 0.4])[1] < 0


def test_euler_angles_turn_about_fixed_axes_in_small_letters_and_turned_ones_in_capitals(tmp_path):
    a, b, c = np.radians([10, 20, 30])
    about = [Rotation.from_rotvec(v) for v in ([a, 0, 0], [0, b, 0], [0, 0, c])]
    fixed = entries(tmp_path, 'euler = "xyz", degrees = [10.0, 20.0, 30.0]').pose("pose").rotation
    turned = entries(tmp_path, 'euler = "XYZ", degrees = [10.0, 20.0, 30.0]').pose("pose").rotation
    assert (fixed * (about[2] * about[1] * about[0]).inv()).magnitude() < 1e-12
    assert (turned * (about[0] * about[1] * about[2]).inv()).magnitude() < 1e-12


@pytest.mark.parametrize(
    "text, says",
    [
        ("rotvec = [0.0, 0.0, 0.0], look_at = [0.0, 0.0, 0.0]", "states its rotation 2 times: rotvec, look_at"),
        ("look_at = [1.0, 2.0, 3.0]", "pose.look_at gives no direction"),
        ("look_at = [1.0, 2.0, 9.0]", "straight above or below"),
        ('euler = "xxz", degrees = [1.0, 2.0, 3.0]', "three axes, as xyz"),
        ('euler = "xyz"', "pose.degrees is missing"),
        ("rotvec = [0.0, 0.0, 0.0], degrees = [1.0, 2.0, 3.0]", "goes with euler"),
        ("look_at = [0.0, 0.0, 0.0], ups = [0.0, 0.0, 1.0]", "is 'up' meant?"),
        ("position_ = [0.0]", "unknown key"),
    ],
)
def test_a_rotation_that_is_unclear_is_refused_with_its_line(tmp_path, text, says):
    with pytest.raises(FileError, match=says) as refused:
        entries(tmp_path, text).pose("pose")
    assert refused.value.line == 1
