"""The likelihood of size and smoothness: the same as by its definition, and its gradient as by differences."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.correction.interpolation.gaussian_process_interpolation import Likelihood


def test_it_is_the_normal_density_and_its_gradient():
    rng = np.random.default_rng(0)
    x, y, v = rng.uniform(-1, 1, (40, 6)), rng.normal(size=40), rng.uniform(0.05, 0.2, 40)
    likelihood, p = Likelihood(x, y, v, 2), np.array([0.1, -0.5, 0.2, 0.3, -1.0])
    size1, length1, size2, length2, noise = np.exp(p)
    gap, square = (x[:, None, 2] - x[None, :, 2]) ** 2, ((x[:, None] - x) ** 2).sum(axis=2)
    K = size1**2 * np.exp(-gap / length1**2 / 2) + size2**2 * np.exp(-square / length2**2 / 2) + np.diag(v + noise**2)
    value, gradient = likelihood(p)
    assert value + 20 * np.log(2 * np.pi) == pytest.approx(-multivariate_normal.logpdf(y, np.zeros(40), K), abs=1e-9)
    steps = [(likelihood(p + 1e-5 * e)[0] - likelihood(p - 1e-5 * e)[0]) / 2e-5 for e in np.eye(5)]
    np.testing.assert_allclose(gradient, steps, rtol=1e-6, atol=1e-6)


def test_a_covariance_that_is_none_is_refused():
    with pytest.raises(np.linalg.LinAlgError, match="3 samples"):
        Likelihood(np.zeros((3, 1)), np.ones(3), np.full(3, -9.0), 0)(np.zeros(5))
