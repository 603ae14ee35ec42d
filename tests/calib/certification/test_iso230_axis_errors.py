"""ISO 230-2:2014's figures of an axis, worked by hand."""

import numpy as np
import pytest

from calib.certification.iso230_and_iso9283_tests import (
    iso230_axis_accuracy,
    iso230_axis_repeatability,
    iso230_reversal_values,
)

MEAN = np.array([[1.0, -1.0], [4.0, 3.0], [2.0, 5.0]])  # from below, from above, at three positions
S = np.array([[0.5, 0.25], [0.25, 0.5], [1.0, 0.25]])


def test_reversal_is_the_greatest_by_size():
    assert iso230_reversal_values(MEAN) == (3.0, pytest.approx(0.0))


def test_accuracy_is_the_range_of_means_and_twice_their_scatter():
    A, up, down = iso230_axis_accuracy(MEAN, S)
    assert (A, up, down) == (5.5 + 1.5, 4.5 - 0.0, 5.5 + 1.5)


def test_repeatability_of_both_directions_holds_the_reversal():
    R, up, down = iso230_axis_repeatability(MEAN, S)
    assert (R, up, down) == (2.0 + 0.5 + 3.0, 4.0, 2.0)


def test_one_visit_shows_no_scatter():
    assert (
        iso230_axis_accuracy(MEAN, np.where(S > 0.9, np.nan, S))
        == (None, None, None)
        == iso230_axis_repeatability(MEAN, np.where(S > 0.9, np.nan, S))
    )
