"""Positions on slides do not tell a shift of the base from one of the tool: only their sum has a figure."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.models.base_and_tool_displacement_between_recordings import (
    estimate_placement,
    placement_with_significant_displacements,
)
from calib.models.base_and_tool_placement import Placement
from calib.samples.commanded_and_measured_pose_samples import Samples

COUNT, SIGMA = 60, 5e-6
TURN = Rotation.from_rotvec([0.3, -0.2, 1.0])  # of the target in the frame of poses, the same in every pose
BOTH = (True, True)
UP = np.array([0.0, 0.0, 1.0])


def placement(points, turns, shift):
    """Placement by positions (n, 3) m of a target turned by Rotations (n,), of which a base moved by a shift (3,) m."""
    rng = np.random.default_rng(3)
    predicted = RigidTransform.from_components(points, turns)
    seen = RigidTransform.from_translation(points + shift + rng.normal(0, SIGMA, points.shape))
    covariance = np.tile(np.diag([SIGMA**2] * 3 + [np.inf] * 3), (COUNT, 1, 1))
    row = np.arange(COUNT)
    samples = Samples(row, 10.0 * row, np.zeros((COUNT, 3)), seen, covariance, np.zeros((COUNT, 6, 0)))
    found = estimate_placement(predicted, samples, np.zeros(3), np.zeros(6), BOTH)
    return placement_with_significant_displacements(found, BOTH, True)


def slid(shift):
    points = np.random.default_rng(1).uniform([0, 0, 0.4], [0.7, 0.4, 0.9], (COUNT, 3))
    return placement(points, Rotation.concatenate([TURN] * COUNT), shift)


def millimetres(line):
    """Numbers of a line in mm."""
    return [float(number) for number in re.findall(r"([\d.e+-]+) mm", line)]


def test_slides_tell_the_sum_of_both_shifts_alone():
    found = slid(np.zeros(3))
    lines = found.lines()
    assert lines[0].startswith("base and tool together stand where they stood, to +- ")
    assert "do not distinguish a shift of the base from one of the tool" in lines[0]
    assert len(lines) == 2 and "mm" not in lines[1]
    assert re.fullmatch(r"the base stands as it stood in rotation, to \+- [\d.]+ mrad \(k = 2\)", lines[1])
    (within,) = millimetres(lines[0])
    mean = 2 * SIGMA / np.sqrt(COUNT) * 1e3  # mm
    assert 0.8 * mean < within < 1.5 * mean
    entry = found.entry()
    assert entry["base"]["position"] == entry["tool"]["position"] == {"value": None, "U": None, "directions": 0}
    assert entry["base"]["rotation"]["directions"] == 3 and entry["tool"]["rotation"]["directions"] == 0


def test_a_shift_is_named_and_given_to_neither():
    shift = np.array([2e-3, -1e-3, 2e-3])
    line, *_ = slid(shift).lines()
    assert line.startswith("base and tool together displace the poses by ")
    size, within = millimetres(line)
    assert size == pytest.approx(3.0, abs=0.01) and within < 0.01
    entry = slid(shift).entry()
    assert [entry[end]["stands_elsewhere"] for end in ("base", "tool")] == [None, None]


def test_turns_about_one_axis_leave_one_direction_open():
    """Along the axis of all turns, a shift of the base is one of the tool; across it both are determined."""
    rng = np.random.default_rng(4)
    points, turns = rng.uniform(-0.5, 0.5, (COUNT, 3)), Rotation.from_rotvec(np.outer(rng.uniform(-3, 3, COUNT), UP))
    for shift, elsewhere in ((2e-3 * UP, None), (np.array([2e-3, 0, 0]), True)):
        found = placement(points, turns, shift)
        entry = found.entry()["base"]
        assert entry["position"]["directions"] == 2 and entry["stands_elsewhere"] is elsewhere
        lines = found.lines()
        assert lines[0].startswith("base and tool together displace the poses by 2")
        assert lines[1].startswith("the base stands elsewhere: by 2" if elsewhere else "the base stands where it stood")
        assert "mm in 2 of 3 directions" in lines[1]


@pytest.mark.parametrize("open_directions", [1, 2])
@pytest.mark.parametrize(("size", "elsewhere"), [(0.0, None), (1e-3, True)])
def test_what_is_determined_decides_whether_an_end_stands_elsewhere(open_directions, size, elsewhere):
    """A shift of both together is ascribed to the base by its probability alone, which no figure of it confirms."""
    sigma = np.array([1e-5, 1.0 if open_directions == 2 else 1e-5, 1.0, *[1e-5] * 3])
    base = RigidTransform.from_translation([size, 0.0, 0.02])
    covariance = np.diag(np.r_[sigma, sigma] ** 2)
    found = Placement(base, RigidTransform.identity(), np.zeros(3), covariance, BOTH, (1e-9, 1.0))
    entry = found.entry()
    assert entry["base"]["stands_elsewhere"] is elsewhere and entry["tool"]["stands_elsewhere"] is None
    assert entry["base"]["position"]["directions"] == 3 - open_directions
    assert f"in {3 - open_directions} of 3 directions" in found.lines()[1]
    still = replace(found, p_values=(1.0, 1.0), base=RigidTransform.identity())
    assert [still.entry()[end]["stands_elsewhere"] for end in ("base", "tool")] == [False, False]


def test_a_base_that_is_turned_is_named_where_its_position_is_open():
    covariance = np.diag(np.r_[np.ones(3), [1e-10] * 3, np.ones(3), np.zeros(3)])
    turned = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.0, 1e-3]))
    found = Placement(turned, RigidTransform.identity(), np.zeros(3), covariance, BOTH, (1e-9, 1.0))
    assert found.entry()["base"]["stands_elsewhere"] is True and found.entry()["tool"]["stands_elsewhere"] is None
    assert found.lines()[1].startswith("the base is turned by 1 mrad, +- 0.02 mrad")


def test_joints_tell_both_and_no_rotation_of_the_tool():
    rng = np.random.default_rng(2)
    base, tool = placement(rng.uniform(-0.5, 0.5, (COUNT, 3)), Rotation.random(COUNT, rng=rng), np.zeros(3)).lines()
    assert re.fullmatch(r"the base stands where it stood, to \+- [\d.]+ mm and [\d.]+ mrad \(k = 2\)", base)
    assert re.fullmatch(r"the tool stands where it stood, to \+- [\d.]+ mm \(k = 2\)", tool)
