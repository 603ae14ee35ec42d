"""A URDF with several tips is one arm: each hand's kinematics to 1e-12, shared joints once, and what cannot be read."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig.errors import RigError
from rig.formats.exporters.urdf_and_sdf_export_of_arms_and_hexapods import arm_urdf
from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions, read_arm_file
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.model.pose import pose_difference
from rig.recording.recording_folder import load_recording
from tests.cli import run
from tests.rig.formats.importers.urdf_products import product, robot

TURN = {"limit": (-2.0, 2.0)}
HUMANOID = robot(
    ("waist", "revolute", "world", "hip", {"xyz": (0, 0.1, 0.4), "axis": (0, 0, 1), **TURN}),
    ("lift", "prismatic", "hip", "chest", {"xyz": (0.1, 0, 0.2), "axis": (0, 0.1, 1), "limit": (0, 0.3)}),
    ("plate", "fixed", "chest", "plate", {"xyz": (0, 0, 0.1), "rpy": (0.1, 0.2, 0.3)}),
    ("l_shoulder", "revolute", "plate", "l1", {"xyz": (0, 0.2, 0), "axis": (0, 1, 0), **TURN}),
    ("l_elbow", "revolute", "l1", "l2", {"xyz": (0, 0.1, -0.3), "axis": (1, 0, 0), **TURN}),
    ("l_end", "fixed", "l2", "left", {"xyz": (0, 0, -0.3), "rpy": (0, 0.1, 0)}),
    ("r_shoulder", "revolute", "plate", "r1", {"xyz": (0, -0.2, 0), "axis": (0.1, 1, 0), **TURN}),
    ("r_elbow", "continuous", "r1", "right", {"xyz": (0, -0.1, -0.3), "axis": (1, 0, 0)}),
    ("thumb", "revolute", "right", "thumb", {"xyz": (0, -0.05, -0.1), "axis": (0, 0, 1), **TURN}),
    ("neck", "revolute", "world", "head", {"xyz": (0, 0.1, 1.4), "axis": (0, 0, 1), **TURN}),
)


def read(tmp_path, tips, text=HUMANOID, root=None):
    (tmp_path / "robot.urdf").write_text(text)
    found = read_arm_file(ArmFileOptions(tmp_path / "robot.urdf", tips, root))
    (tmp_path / "rig.toml").write_text(found.rig_toml())
    return found, design_from_rig_toml.load_design(tmp_path / "rig.toml").mechanism


@pytest.mark.parametrize(
    ("tips", "count"),
    [
        (("left", "right"), 6),
        (("right", "left"), 6),
        (("left", "right", "thumb"), 7),  # a hand on a hand
        (("thumb", "left", "right"), 7),  # a tip on the way to another
        (("left", "chest"), 4),  # a tip on the trunk
        (("left", "head"), 5),  # nothing shared but the base
    ],
)
def test_every_hand_stands_where_the_urdf_has_its_tip(tmp_path, tips, count):
    found, arm = read(tmp_path, tips)
    assert len(found.joint_names) == count == len(arm.axes) and [hand.name for hand in arm.hands] == list(tips)
    rng = np.random.default_rng(3)
    for q in rng.uniform(*arm.limits.T, (10, count)):
        for tip in tips:
            expected = product(HUMANOID, dict(zip(found.joint_names, q)), tip)
            np.testing.assert_allclose(serial.forward(q, arm.of_hand(tip)).as_matrix(), expected, rtol=0, atol=1e-12)


def test_what_was_read_names_each_joint_once_and_those_that_are_shared(tmp_path):
    found, arm = read(tmp_path, ("left", "right"))
    assert sum("waist" in line for line in found.lines) == 2  # once read, once among those shared
    assert found.lines[-1] == "joints that all hands share: waist, lift"
    assert arm.parents.tolist() == [-1, 0, 1, 2, 1, 4]
    assert not [line for line in found.lines if line.startswith("ignored")]


@pytest.mark.parametrize(
    ("tips", "message"),
    [
        (("left", "rigth"), "--tip 'rigth' is no link; is 'right' meant?"),
        (("left", "left"), "--tip 'left' is named twice"),
        (("left", "world"), "no joint between 'world' and 'world' moves"),
    ],
)
def test_a_tip_that_makes_no_hand_is_named(tmp_path, tips, message):
    (tmp_path / "robot.urdf").write_text(HUMANOID)
    with pytest.raises(RigError, match=message.replace("?", r"\?")):
        read_arm_file(ArmFileOptions(tmp_path / "robot.urdf", tips))


def test_the_command_reads_several_tips_and_states_the_rig_in_other_units(tmp_path):
    (tmp_path / "robot.urdf").write_text(HUMANOID)
    out, given = tmp_path / "rig.toml", ("--urdf", tmp_path / "robot.urdf", "--tip", "left", "--tip", "right")
    done = run("new", "design", *given, "--units", "mm,deg", "--out", out)
    assert done.returncode == 0 and "read joint r_elbow: continuous" in done.stderr
    _, arm = read(tmp_path, ("left", "right"))
    stated = design_from_rig_toml.load_design(out).mechanism
    q = np.random.default_rng(0).uniform(*arm.limits.T, (5, 6))
    for hand in ("left", "right"):
        expected, found = (serial.forward(q, one.of_hand(hand)).as_matrix() for one in (arm, stated))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


JOINTS = ("waist", "lift", "l_shoulder", "l_elbow", "r_shoulder", "r_elbow")
BOTH = [(k, hand) for k in range(8) for hand in ("right", "left")]
HEADER = "time;gripper;x [mm];y [mm];z [mm];rx;ry;rz"
STATED = ("--set", "poses.rotation=rotvec", "--set", "poses.rotation_unit=rad")


def imported(folder, header=HEADER, rows=BOTH, more=(), ok=True, change=("", "")):
    """`rig import` of a log of commands in degrees and mm, and of a table of two hands' poses, as others write them."""
    (folder / "robot.urdf").write_text(HUMANOID)
    given = ("--urdf", folder / "robot.urdf", "--tip", "left", "--tip", "right")
    run("new", "design", *given, "--out", folder / "rig.toml", "--force")
    q = np.random.default_rng(2).uniform(-0.8, 0.8, (8, 6)) * [1, 0.1, 1, 1, 1, 1] + [0, 0.1, 0, 0, 0, 0]
    shown = q * np.where(np.arange(6) == 1, 1e3, 180 / np.pi)
    log = ["time;j1 [deg];j2 [mm];j3 [deg];j4 [deg];j5 [deg];j6 [deg]"]
    log += [f"{k};" + ";".join(f"{x:.9f}" for x in row) for k, row in enumerate(shown)]
    (folder / "log.csv").write_text("\n".join(log) + "\n")
    seen = [header]
    for k, hand in rows:
        M = product(HUMANOID, dict(zip(JOINTS, q[k])), hand)
        figures = (*(1e3 * M[:3, 3]), *Rotation.from_matrix(M[:3, :3]).as_rotvec())
        seen.append(f"{k};{hand};" + ";".join(f"{x:.9f}" for x in figures))
    (folder / "seen.csv").write_text("\n".join(seen).replace(*change) + "\n")
    tables = ("--commands", folder / "log.csv", "--poses", folder / "seen.csv")
    return run("import", "--rig", folder / "rig.toml", *tables, *more, "--out", folder / "REC", ok=ok)


def test_poses_of_two_hands_are_imported_with_the_hand_of_each(tmp_path):
    rows = sorted((row for row in BOTH if row != (3, "left")), key=lambda row: row[1])
    done = imported(tmp_path, rows=rows)
    assert "rotations are rotation vectors in rad, which agree with the commands" in done.stdout
    found = load_recording(tmp_path / "REC")
    assert found.poses.frame.tolist() == [0, 0, 1, 1, 2, 2, 3, *np.repeat(range(4, 8), 2)]
    frames, _, q = found.commanded()
    q = q[np.searchsorted(frames, found.poses.frame)]
    expected = serial.hand_pose_of_each_row(q, found.design.mechanism, found.poses.hand)
    assert np.abs(pose_difference(expected, found.poses.T_base_platform)).max() < 1e-8


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"rows": [(0, "left"), (1, "right"), (1, "right")]},
            "seen.csv:4: t 1 is in line 3 as well; 1 of 3 rows repeat a hand of a frame",
        ),
        ({"header": HEADER.replace("time", "a")}, "belong to frames by a column frame or t; add one"),
        ({"header": HEADER.replace("gripper", "which")}, "seen.csv: no column is hand; columns of unknown meaning are"),
        ({"change": ("2;right", "2;rigth")}, "seen.csv:6:2: 'rigth' is no hand; is 'right' meant?"),
    ],
)
def test_a_table_of_two_hands_that_cannot_be_read_is_named(tmp_path, given, message):
    assert message in imported(tmp_path, more=STATED, ok=False, **given).stderr


@pytest.mark.parametrize("tips", [("left", "right"), ("thumb", "left", "right"), ("left", "head")])
def test_an_arm_with_several_hands_comes_back_from_its_own_urdf(tmp_path, tips):
    _, stated = read(tmp_path, tips)
    _, arm = read(tmp_path, tips, arm_urdf(stated), "base")
    for q in np.random.default_rng(3).uniform(*arm.limits.T, (5, len(arm.axes))):
        for tip in tips:
            found, expected = (serial.forward(q, one.of_hand(tip)).as_matrix() for one in (arm, stated))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
