"""The measure by which lenses are compared."""

import numpy as np
import pytest

from tests.bench.peers import TRUE, projection_error


def test_a_lens_is_off_by_nothing_from_itself_and_by_a_wrong_focal_length():
    K, terms = TRUE["left"]
    assert projection_error(K, terms, K, terms) < 1e-6
    assert projection_error(K + np.diag([9.0, 9.0, 0]), terms, K, terms) > 1


def test_a_turned_camera_is_not_a_wrong_lens():
    K, terms = TRUE["left"]
    shifted = K.copy()
    shifted[0, 2] += 0.5
    assert projection_error(shifted, terms, K, terms) == pytest.approx(0.0, abs=0.1)
