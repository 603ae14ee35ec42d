"""Sobol points: SciPy's own, to the last bit, in as many dimensions as are kept here and beyond."""

import numpy as np
import pytest
from scipy.stats import qmc

from rig.planning.sobol_points import KNOWN, sobol_points


@pytest.mark.parametrize("axes", range(1, len(KNOWN) + 4))
def test_they_are_those_of_scipys_engine(axes):
    for count, seed in ((1, 0), (2, 1), (60, 3), (256, 0)):
        whole = max(int(np.ceil(np.log2(count))), 1)
        np.testing.assert_array_equal(
            sobol_points(axes, count, seed),
            qmc.Sobol(axes, rng=np.random.default_rng(seed)).random_base2(whole)[:count],
        )
