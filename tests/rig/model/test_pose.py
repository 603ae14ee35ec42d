import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.errors import NotEnoughData
from rig.model.pose import (
    align_poses,
    covariance_from_triangle,
    exp,
    log,
    pose,
    pose_difference,
    pose_to_vector,
    roll_pitch_yaw,
    roll_pitch_yaw_sigmas,
    transform_points,
)
from tests.numerical_derivatives import jacobian


def test_exp_and_log_undo_each_other_over_batch_shapes():
    rng = np.random.default_rng(0)
    for shape in ((), (3,), (2, 4)):
        xi = rng.normal(size=(*shape, 6)) * [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]
        np.testing.assert_allclose(log(exp(xi)), xi, atol=1e-12)


def test_translation_comes_first():
    np.testing.assert_allclose(exp(np.array([1, 2, 3, 0, 0, 0.0])).translation, [1, 2, 3])
    np.testing.assert_allclose(pose_to_vector(pose([1, 2, 3], [0.1, 0.2, 0.3])), [1, 2, 3, 0.1, 0.2, 0.3], atol=1e-15)


def test_difference_is_the_small_motion_on_the_right():
    T = pose([0.3, -0.2, 0.5], [0.4, 0.1, -0.7])
    xi = np.array([1e-6, -2e-6, 3e-6, 4e-6, 5e-6, -6e-6])
    np.testing.assert_allclose(pose_difference(T, T * exp(xi)), xi, atol=1e-11)


def test_transform_points_is_apply_for_batches():
    rng = np.random.default_rng(1)
    T, points = exp(rng.normal(size=(5, 6))), rng.normal(size=(7, 3))
    np.testing.assert_allclose(transform_points(T, points), [T[i].apply(points) for i in range(5)], atol=1e-14)


def test_triangle_is_read_row_by_row():
    C = covariance_from_triangle(np.arange(21.0))
    assert C[0, 5] == C[5, 0] == 5 and C[1, 1] == 6 and C[5, 5] == 20


def test_roll_pitch_and_yaw_are_about_the_static_axes():
    rng = np.random.default_rng(4)
    flat = rng.uniform(-1.5, 1.5, (15, 3))
    T = RigidTransform.from_rotation(Rotation.from_euler("xyz", flat))
    np.testing.assert_allclose(roll_pitch_yaw(T), flat, atol=1e-12)
    np.testing.assert_allclose(roll_pitch_yaw(T[0]), flat[0], atol=1e-12)
    covariance = np.diag([1e-5, 1e-5, 1e-5, 1e-3, 2e-3, 3e-3]) ** 2
    for one in range(4):
        J = jacobian(lambda xi, one=one: roll_pitch_yaw(T[one] * exp(xi)), np.zeros(6))
        np.testing.assert_allclose(
            roll_pitch_yaw_sigmas(T[one], covariance), np.sqrt(np.diag(J @ covariance @ J.T)), rtol=1e-6
        )


def test_at_a_quarter_turn_of_pitch_roll_is_told_and_no_uncertainty():
    for pitch in (np.pi / 2, -np.pi / 2):
        T = pose([0, 0, 0], (Rotation.from_euler("y", pitch) * Rotation.from_euler("x", 0.3)).as_rotvec())
        np.testing.assert_allclose(roll_pitch_yaw(T), [0.3, pitch, 0], atol=1e-7)
        assert np.isinf(roll_pitch_yaw_sigmas(T, np.eye(6)))[[0, 2]].all()


def test_too_few_poses_and_positions_on_a_line_place_no_instrument():
    rng = np.random.default_rng(3)
    T = RigidTransform.from_components(rng.normal(size=(6, 3)), Rotation.random(6, rng=rng))
    for count in (1, 3):
        with pytest.raises(NotEnoughData, match=f"4 poses at least, not {count}"):
            align_poses(T[:count], T[:count], (True, True))
    line = RigidTransform.from_translation(np.outer(np.arange(6.0), [1.0, 2.0, 0.5]))
    with pytest.raises(NotEnoughData, match="6 positions on a line"):
        align_poses(line, line, (True, False), 3)
