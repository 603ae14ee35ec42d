"""What pixels near a marker's edges are taken for, and the order statistics that fits use."""

import numpy as np
import pytest

from vision.corners.blurred_edge_image_model_and_numba_kernels import order_statistic
from vision.corners.edge_pixels import MEETS, NONE, NOWHERE, VIEWS, pixel_edge_kinds
from vision.marker_corner_prediction import marker_cells

LEFT, RIGHT, TOP, BOTTOM = 1, 2, 4, 8


def edge_kind(cells, row, column, sides):
    return int(pixel_edge_kinds(np.array(cells, float))[(row * 16 + column) * VIEWS + sides])


def test_pixels_are_taken_for_what_they_see():
    corner = [[1, 1, 1], [1, 1, 0], [1, 0, 0]]
    assert edge_kind(corner, 1, 1, LEFT | TOP) == NONE
    assert edge_kind(corner, 1, 1, RIGHT) == 2 + 2 + 1  # one upright edge, the cell's right side, white first
    assert edge_kind(corner, 1, 2, TOP) == 2 + 4 + 1  # one level edge, the cell's upper side, white first
    assert (
        edge_kind(corner, 1, 1, RIGHT | BOTTOM) == MEETS + 16 + 32 + 1
    )  # they meet at its right and bottom: white at the top left alone
    assert edge_kind(corner, 0, 2, LEFT | BOTTOM) == MEETS + 32 + 1 + 2 + 4
    assert edge_kind(corner, 1, 1, 16) == 1  # where cells beyond the next are in sight


def test_what_is_out_of_reach_is_nothing_and_large_markers_are_refused():
    assert pixel_edge_kinds(marker_cells("DICT_7X7_50", 3))[NOWHERE] == NONE
    with pytest.raises(ValueError, match="16 cells"):
        pixel_edge_kinds(np.ones((17, 17)))


def test_ranks_are_those_of_sorting():
    rng = np.random.default_rng(0)
    for size in (1, 2, 7, 300):
        values = rng.normal(0, 20, size)
        for rank in {0, size // 2, size - 1}:
            assert order_statistic(values, rank) == pytest.approx(
                np.sort(values)[rank], abs=np.ptp(values) / 16000 + 1e-12
            )
    assert order_statistic(np.zeros(0), 0) == 0
