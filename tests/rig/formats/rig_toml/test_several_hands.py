"""An arm with several hands in rig.toml and its poses.csv: what is read, and complaints that name file and line."""

import re

import numpy as np
import pytest

from calib.files.mechanism_and_physics_entries import mechanism_dict, mechanism_from_entries
from rig.errors import FileError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.recording.frame_selection_and_content_hashes import remove_frames, select_hand
from rig.recording.recording_folder import load_recording
from tests.two_armed import HUMANOID, humanoid

TEXT = HUMANOID.read_text()
HAND = '[[mechanism.hand]]\nname = "right"'
CUBE = '[[target]]\nname = "P"\nbody = "platform"\n[instrument]'


def test_branches_and_hands_are_read_and_survive_a_calibration_file():
    arm = humanoid().mechanism
    assert [hand.name for hand in arm.hands] == ["left", "right"] and arm.kind == "arm"
    assert arm.parents.tolist() == [-1, 0, 1, 2, 3, 4, 5, 6, 7, 2, 9, 10, 11, 12, 13]
    reread = mechanism_from_entries(Entries(mechanism_dict(arm), (), HUMANOID, {}))
    q = np.random.default_rng(0).uniform(*arm.limits.T, (4, 15))
    for hand in ("left", "right"):
        found, stated = (serial.forward(q, one.of_hand(hand)).as_matrix() for one in (reread, arm))
        np.testing.assert_allclose(found, stated, atol=1e-14)
    assert reread.hands[1].mass == 3.0 and reread.hands[0].centre_of_mass.tolist() == [0.03, 0.0, -0.02]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("joint = 10\nparent = 3", "joint = 10\nparent = 12", "parent must be a joint before joint 10"),
        ("joint = 10\nparent", "joint = 16\nparent", "there is no joint 16, the arm has 15"),
        ("joint = 10\nparent", "joint = 4\nparent", "joint 4 has a [[mechanism.branch]] already"),
        ("joint = 10\nparent", "joint = 10\nparrent", "is 'parent' meant"),
        ("joint = 15\ntool", "joint = 25\ntool", "there is no joint 25"),
        ('name = "right"', 'name = "left"', "hand 'left' is listed twice"),
        ('name = "right"', 'name = "right, hand"', "name"),
        ("mass = 3.0", "mass = -3.0", "mass"),
        ("\n[instrument]", "\n[platform]\nmass = 1.0\n[instrument]", "each hand states its own mass"),
        ("\n[instrument]", CUBE, "target.1.body must be one of 'base', 'left', 'right', not 'platform'"),
        ('base = "free"', 'base = "free"\nkind = "distance"', "poses or positions of several hands"),
        ('kind = "arm"', 'kind = "arm"\ntool = { position = [0, 0, 0], rotvec = [0, 0, 0] }', "states its own tool"),
    ],
)
def test_what_makes_no_tree_of_joints_is_named_with_its_line(tmp_path, old, new, says):
    assert old in TEXT
    path = tmp_path / "rig.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(FileError, match=re.escape(says)) as caught:
        design_from_rig_toml.load_design(path)
    assert caught.value.path == str(path) and caught.value.line is not None


def test_one_hand_alone_is_stated_as_before(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(TEXT[: TEXT.index(HAND)] + TEXT[TEXT.index("[instrument]") :])
    with pytest.raises(FileError, match="an arm with one hand states none; write its tool in"):
        design_from_rig_toml.load_design(path)


POSES = """frame,hand,x,y,z,rx,ry,rz
1,right,0.1,0,0,0,0,0
0,left,0.2,0,0,0,0,0
0,right,0.3,0,0,0,0,0
2,left,0.4,0,0,0,0,0
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.toml").write_text(TEXT)
    names = [f"q{i + 1}" for i in range(15)]
    zeros = ",".join(["0"] * 15)
    (tmp_path / "commands.csv").write_text(f"t,{','.join(names)}\n" + "".join(f"{t},{zeros}\n" for t in range(4)))
    (tmp_path / "frames.csv").write_text("frame,t,camera,image\n" + "".join(f"{f},{f}.5,,\n" for f in range(3)))
    (tmp_path / "poses.csv").write_text(POSES)
    return tmp_path


def test_each_pose_is_of_its_hand_in_the_order_of_frames(folder):
    recording = load_recording(folder)
    assert recording.poses.frame.tolist() == [0, 0, 1, 2] and recording.poses.hand.tolist() == [0, 1, 1, 0]
    right = select_hand(recording, "right")
    assert right.poses.hand is None and right.poses.frame.tolist() == [0, 1] and right.design.mechanism.hand == 1
    np.testing.assert_allclose(right.poses.T_base_platform.translation[:, 0], [0.3, 0.1])
    assert remove_frames(recording, "0").poses.hand.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("old", "new", "says", "line"),
    [
        ("2,left", "2,lefd", "'lefd' is no hand; is 'left' meant?", 5),
        ("0,right,0.3", "0,left,0.3", "frame 0 of hand 'left' is listed twice, first in line 3", 4),
        ("2,left", "7,left", "frame 7 is not in frames.csv", 5),
        ("frame,hand", "frame,hnd", "'hand'", 1),
        ("2,left", "2,", "'' is no hand; rig.toml has left, right", 5),
    ],
)
def test_a_hand_that_is_none_is_named_with_its_line(folder, old, new, says, line):
    (folder / "poses.csv").write_text(POSES.replace(old, new, 1))
    with pytest.raises(FileError, match=re.escape(says)) as caught:
        load_recording(folder)
    assert caught.value.line == line
