"""The lens against OpenCV's, term by term, and against differences."""

import cv2
import numpy as np
import pytest

from rig.model.design import DISTORTION_TERMS
from vision import opencv_lens_model as lens

TERMS = np.array([-0.12, 0.09, 4e-4, -3e-4, 0.02, 0.05, 0.01, 0.003, 1e-3, 2e-3, -1e-3, 5e-4, 0.01, -0.02])
MATRIX = np.array([[1750.0, 0, 630], [0, 1740, 515], [0, 0, 1]])


@pytest.fixture
def points():
    rng = np.random.default_rng(1)
    return np.c_[rng.uniform(-0.4, 0.4, (50, 2)), np.ones(50)] * rng.uniform(0.5, 2, (50, 1))


@pytest.mark.parametrize("count", DISTORTION_TERMS)
def test_projection_and_jacobians_equal_opencv(points, count):
    reference, J = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, TERMS[:count])
    uv, J_point, J_lens = lens.projected_pixels_and_jacobians(points, MATRIX, TERMS[:count])
    J = J.reshape(50, 2, -1)
    np.testing.assert_allclose(uv, reference.reshape(-1, 2), atol=1e-10)
    np.testing.assert_allclose(lens.project(points, MATRIX, TERMS[:count]), uv, atol=1e-12)
    np.testing.assert_allclose(J_point, J[:, :, 3:6], atol=1e-9)
    np.testing.assert_allclose(J_lens, J[:, :, 6:], atol=1e-9)
    assert len(lens.lens_parameter_names(TERMS[:count])) == 4 + count


@pytest.mark.parametrize("count", DISTORTION_TERMS)
def test_undistort_undoes_projection(points, count):
    uv = lens.project(points, MATRIX, TERMS[:count])
    np.testing.assert_allclose(lens.undistort(uv, MATRIX, TERMS[:count]), points[:, :2] / points[:, 2:], atol=1e-12)


def test_a_pixel_that_no_ray_reaches_is_nan():
    folding = np.array([-2.0, 0, 0, 0])  # the image folds back at r = 0.41, 0.27 from the middle
    inside, outside = MATRIX[:2, 2] + [100, 0], MATRIX[:2, 2] + [1600, 0]
    found = lens.undistort(np.array([inside, outside]), MATRIX, folding)
    assert np.isfinite(found[0]).all() and np.isnan(found[1]).all()
