"""Sobol points are those of SciPy, bit by bit."""

import numpy as np
import pytest
from scipy.stats import qmc

from rig.planning.configuration_generators import sobol_configurations
from rig.planning.sobol_points import DIRECTIONS, scrambled_sobol_points


@pytest.mark.parametrize("axes", range(1, len(DIRECTIONS) + 1))
def test_points_are_those_of_scipy(axes):
    for power in (1, 2, 5, 9):
        for seed in (0, 7):
            expected = qmc.Sobol(axes, rng=np.random.default_rng(seed)).random_base2(power)
            assert np.array_equal(scrambled_sobol_points(axes, power, seed), expected)


def test_of_more_axes_and_other_counts_they_are_too():
    for axes, count in ((len(DIRECTIONS) + 3, 16), (6, 11)):
        found = sobol_configurations(np.tile([0.0, 1.0], (axes, 1)), count, fill=1.0, seed=3)
        expected = qmc.Sobol(axes, rng=np.random.default_rng(3)).random_base2(4)[:count]
        assert np.abs(found - expected).max() < 1e-15
