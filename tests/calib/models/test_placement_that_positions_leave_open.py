"""Positions on slides do not tell a shift of the base from one of the tool: only their sum has a figure."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.models.base_and_tool_displacement_between_recordings import (
    estimate_placement,
    placement_with_significant_displacements,
)
from calib.samples.commanded_and_measured_pose_samples import Samples

COUNT, SIGMA = 60, 5e-6
TURN = Rotation.from_rotvec([0.3, -0.2, 1.0])  # of the target in the frame of poses, the same in every pose
BOTH = (True, True)


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
    assert len(lines) == 2 and lines[1].startswith("the base is turned by ") and "mm" not in lines[1]
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


def test_joints_tell_both_and_no_rotation_of_the_tool():
    rng = np.random.default_rng(2)
    base, tool = placement(rng.uniform(-0.5, 0.5, (COUNT, 3)), Rotation.random(COUNT, rng=rng), np.zeros(3)).lines()
    assert re.fullmatch(r"the base stands where it stood, to \+- [\d.]+ mm and [\d.]+ mrad \(k = 2\)", base)
    assert re.fullmatch(r"the tool stands where it stood, to \+- [\d.]+ mm \(k = 2\)", tool)
