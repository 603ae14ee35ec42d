"""Wanted poses of one of an arm's several hands, out of a table whose column `hand` names it row by row."""

import re

import numpy as np
import pytest

from rig.errors import FileError
from rig.recording.wanted_poses_and_roll_pitch_yaw import load_wanted_poses
from tests.two_armed import humanoid

BOTH = """frame,hand,t,x,y,z,rx,ry,rz
0,left,10,0.1,0,0,0,0,0
0,right,11,0.2,0,0,0,0,0
1,left,12,0.3,0,0,0,0,0
1,right,13,0.4,0,0,0,0,0
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "wanted.csv").write_text(BOTH)
    return tmp_path / "wanted.csv"


@pytest.mark.parametrize(("hand", "x"), [("left", [0.1, 0.3]), ("right", [0.2, 0.4])])
def test_the_rows_of_the_hand_are_taken_with_their_times(path, hand, x):
    wanted = load_wanted_poses(path, mechanism=humanoid().mechanism.of_hand(hand))
    assert wanted.poses.frame.tolist() == [0, 1] and wanted.poses.hand is None
    np.testing.assert_array_equal(wanted.poses.T_base_platform.translation[:, 0], x)
    assert wanted.t.tolist() == [0, 2] and wanted.origin.offset == (10 if hand == "left" else 11)


def test_a_table_without_the_column_is_all_of_that_hand(path):
    path.write_text("frame,x,y,z,rx,ry,rz\n0,0.1,0,0,0,0,0\n4,0.3,0,0,0,0,0\n")
    wanted = load_wanted_poses(path, mechanism=humanoid().mechanism.of_hand("right"))
    assert wanted.poses.frame.tolist() == [0, 4] and wanted.t is None


@pytest.mark.parametrize(
    ("text", "says", "line", "value"),
    [
        (BOTH.replace("1,left", "1,lefd"), "'lefd' is no hand; is 'left' meant?", 4, "lefd"),
        (BOTH.replace("right", "left"), "no row is of hand 'right', only of left", 2, "left"),
        (BOTH.replace("1,right", "0,right"), "frame 0 is listed twice, first in line 3", 5, 0),
        (BOTH.replace("hand", "hannd"), "unknown column 'hannd'; is 'hand' meant?", 1, "hannd"),
        ("frame,hand,azimuth,elevation\n0,right,0.1,0.2\n", "a direction has no column hand", 2, "right"),
    ],
)
def test_what_is_of_no_hand_is_named_with_its_line(path, text, says, line, value):
    path.write_text(text)
    with pytest.raises(FileError, match=re.escape(says)) as caught:
        load_wanted_poses(path, mechanism=humanoid().mechanism.of_hand("right"))
    assert caught.value.line == line and caught.value.value == value
