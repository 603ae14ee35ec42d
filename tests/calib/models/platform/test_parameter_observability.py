"""What poses determine: frames moved as a whole, names of combinations, and the count of what is seen."""

import numpy as np
import pytest

from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    parameter_changes_by_base_and_platform_frame_motion,
    parameter_combinations_and_visibility,
)
from calib.models.platform.platform_identification import identify_platform, pose_parameter_jacobian
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    geometric_parameters,
    mechanism_with_parameters,
    parameter_names,
)
from rig.model.pose import exp, pose_difference, transform_points
from tests.calib.noisy_samples import sampled, workspace


def test_gauge_is_the_motion_of_the_frames(design):
    """Moving a plate's joints with its frame moves the measured pose as the frame does, and nothing else."""
    T, m = workspace(design, 20), design.mechanism
    J = pose_parameter_jacobian(T, m) @ parameter_changes_by_base_and_platform_frame_motion(m)
    np.testing.assert_allclose(J[:, :, 6:], np.broadcast_to(-np.eye(6), (20, 6, 6)), atol=1e-9)
    for k in range(6):
        xi = np.zeros(6)
        xi[k] = 1e-6
        np.testing.assert_allclose(J[:, :, k], pose_difference(T, exp(xi) * T) / 1e-6, atol=1e-6)


def test_gauge_agrees_with_joints_moved(design):
    xi = np.array([1e-4, -2e-4, 5e-5, 3e-4, -1e-4, 2e-4])
    moved = mechanism_with_parameters(
        design.mechanism,
        geometric_parameters(design.mechanism)
        + parameter_changes_by_base_and_platform_frame_motion(design.mechanism) @ np.r_[xi, np.zeros(6)],
    )
    np.testing.assert_allclose(moved.base_joints, transform_points(exp(xi), design.mechanism.base_joints), atol=1e-7)


def test_combinations_are_told_apart_and_named(design):
    samples, _ = sampled(design, 1, count=100)
    found = identify_platform(samples, design.mechanism)
    parts, seen = parameter_combinations_and_visibility(found.root, found.mechanism)
    sigma = [part.sigma for part in parts]
    assert (
        len(parts) == 42
        and sigma == sorted(sigma, reverse=True)
        and seen.condition == pytest.approx(sigma[0] / sigma[-1])
    )
    assert all(part.determined for part in parts) and 50 < seen.condition < 7000
    exact = np.sqrt(parts[5].direction @ np.linalg.inv(found.root.T @ found.root) @ parts[5].direction)
    assert parts[5].sigma == pytest.approx(exact, rel=1e-6)
    assert any("platform joints moved along" in part.name for part in parts[:12])


def test_one_pose_again_and_again_hides_most(design):
    samples, _ = sampled(design, 1, count=100)
    found = identify_platform(samples, design.mechanism)
    J = np.tile(pose_parameter_jacobian(design.mechanism.home, found.mechanism) / 1e-5, (50, 1))
    root = np.linalg.qr(J, mode="r")
    parts, seen = parameter_combinations_and_visibility(
        np.concatenate([root, np.zeros((42 - len(root), 42))]), found.mechanism
    )
    assert sum(part.determined for part in parts) == 6 and seen.condition > 1e9


def test_names_follow_the_parameters(design):
    p = np.arange(42.0)
    m = mechanism_with_parameters(design.mechanism, p)
    named = parameter_names(m)
    assert (
        named[20] == "platform joint 1 z"
        and m.platform_joints[0, 2] == 20
        and named[41] == "zero of strut 6"
        and m.strut_zeros[5] == 41
    )
    np.testing.assert_array_equal(geometric_parameters(m), p)
    assert hexapod.inverse(design.mechanism.home, design.mechanism).shape == (6,)
