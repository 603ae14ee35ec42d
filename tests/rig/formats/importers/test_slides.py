"""Commands of an arm whose joints turn and slide: each column has its own unit."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.formats.importers.foreign_command_table import read_commands
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.planning.layout import shipped_arms_and_layouts


def table(path, header, row):
    path.write_text("\n".join([header, *[row] * 3]) + "\n")
    return ForeignTable(path)


def test_each_column_is_read_in_the_unit_of_its_header(tmp_path):
    read = read_commands(
        table(tmp_path / "c.csv", "frame,q1 [deg],q2 [deg],q3 [mm],q4", "0,90,-45,120,0.5"),
        shipped_arms_and_layouts.load_shipped_arm_design("scara"),
    )
    np.testing.assert_allclose(read.values[0], [np.pi / 2, -np.pi / 4, 0.12, 0.5], atol=1e-12)


@pytest.mark.parametrize(
    "header, row, says",
    [
        ("frame,q1,q2,q3,q4", "0,90,-45,1200,0.5", "beyond the limits in rig.toml in m and in mm"),
        ("frame,q1,q2,q3 [deg],q4", "0,1,1,0.1,0.5", "deg is not a unit of q3, which slides"),
        ("frame,q1 [mm],q2,q3,q4", "0,1,1,0.1,0.5", "mm is not a unit of q1, which turns"),
    ],
)
def test_other_units_are_refused(tmp_path, header, row, says):
    with pytest.raises(RigError, match=says):
        read_commands(table(tmp_path / "c.csv", header, row), shipped_arms_and_layouts.load_shipped_arm_design("scara"))


def test_columns_of_other_names_are_likely_in_the_order_of_their_units(tmp_path):
    """A lift before the joints of an arm: what is numbered 1 there is not the first axis."""
    design = shipped_arms_and_layouts.load_shipped_arm_design("scara")
    header = "frame;joint_a1_deg;joint_a2_deg;hub_mm;joint_a3_deg"
    with pytest.raises(RigError) as raised:
        read_commands(table(tmp_path / "c.csv", header, "0;90;-45;120;0.5"), design)
    message = str(raised.value)
    pairs = zip(range(1, 5), ("joint_a1_deg", "joint_a2_deg", "hub_mm", "joint_a3_deg"))
    assert all(f"--set commands.columns.q{i}={name}" in message for i, name in pairs), message
