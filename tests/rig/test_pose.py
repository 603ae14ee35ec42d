import numpy as np

from rig.pose import covariance_from_triangle, difference, exp, log, pose, transform_points, vector


def test_exp_and_log_undo_each_other_over_batch_shapes():
    rng = np.random.default_rng(0)
    for shape in ((), (3,), (2, 4)):
        xi = rng.normal(size=(*shape, 6)) * [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]
        np.testing.assert_allclose(log(exp(xi)), xi, atol=1e-12)


def test_translation_comes_first():
    np.testing.assert_allclose(exp(np.array([1, 2, 3, 0, 0, 0.0])).translation, [1, 2, 3])
    np.testing.assert_allclose(vector(pose([1, 2, 3], [0.1, 0.2, 0.3])), [1, 2, 3, 0.1, 0.2, 0.3], atol=1e-15)


def test_difference_is_the_small_motion_on_the_right():
    T = pose([0.3, -0.2, 0.5], [0.4, 0.1, -0.7])
    xi = np.array([1e-6, -2e-6, 3e-6, 4e-6, 5e-6, -6e-6])
    np.testing.assert_allclose(difference(T, T * exp(xi)), xi, atol=1e-11)


def test_transform_points_is_apply_for_batches():
    rng = np.random.default_rng(1)
    T, points = exp(rng.normal(size=(5, 6))), rng.normal(size=(7, 3))
    np.testing.assert_allclose(transform_points(T, points), [T[i].apply(points) for i in range(5)], atol=1e-14)


def test_triangle_is_read_row_by_row():
    C = covariance_from_triangle(np.arange(21.0))
    assert C[0, 5] == C[5, 0] == 5 and C[1, 1] == 6 and C[5, 5] == 20
