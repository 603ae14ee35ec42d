"""Sums against many orders at once: as the plain sums."""

import numpy as np
import pytest

from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import sinusoid_weighted_sums


@pytest.mark.parametrize(
    ("step", "first", "count", "low", "high"),
    [(0.85, 3, 500, -3.1, -0.8), (2.0, 0, 40, -1.5, 1.5), (0.01, 100, 7, 0.0, 0.3)],
)
def test_sums_are_the_plain_sums(step, first, count, low, high):
    rng = np.random.default_rng(4)
    q, values = rng.uniform(low, high, 150), rng.normal(size=(150, 3))
    plain = np.exp(1j * np.outer(step * np.arange(first, first + count), q)) @ values
    assert sinusoid_weighted_sums(q, values, step, first, count) == pytest.approx(
        plain, abs=1e-7 * np.abs(values).sum()
    )


def test_one_pose_alone():
    assert sinusoid_weighted_sums(np.array([0.7]), np.array([[2.0]]), 1.0, 1, 5)[:, 0] == pytest.approx(
        2 * np.exp(0.7j * np.arange(1, 6)), abs=1e-7
    )
