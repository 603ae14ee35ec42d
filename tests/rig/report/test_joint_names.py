"""Findings of an arm name its joints as its URDF does, behind their numbers."""

import pytest

from rig.errors import FileError
from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions, read_arm_file
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.rig_toml.design_from_rig_toml import design_of_entries
from rig.report.axis_places_with_joint_names import text_with_joint_names

NAMES = ("rail", "A1", "A2")


@pytest.mark.parametrize(
    "text, says",
    [
        ("backlash at joint 2, gap 3 mrad", "backlash at joint 2 (A1), gap 3 mrad"),
        ("creep at slide 1; joint 2: worn", "creep at slide 1 (rail); joint 2 (A1): worn"),
        ("backlash at joints 2, 3, the strongest", "backlash at joints 2 (A1), 3 (A2), the strongest"),
        ("joint 2 (A1) and joint 7", "joint 2 (A1) and joint 7"),
        ("strut 2, rejoint 2, joint 0", "strut 2, rejoint 2, joint 0"),
    ],
)
def test_names_stand_behind_numbers_once(text, says):
    assert text_with_joint_names(text, NAMES) == says
    assert text_with_joint_names(text, ()) == text


URDF = """<robot name="two"><link name="a"/><link name="b"/><link name="c"/>
<joint name="shoulder" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.4 0 0" rpy="1.57 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>
"""


def test_a_urdf_states_the_names_of_its_joints_in_rig_toml(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    text = read_arm_file(ArmFileOptions(path)).rig_toml()
    assert design_of_entries(toml_entries(text, path)).joint_names == ("shoulder", "elbow")
    with pytest.raises(FileError, match="joint_names must name each of the 2 joints, not 1"):
        design_of_entries(toml_entries(text.replace('["shoulder", "elbow"]', '["elbow"]'), path))
