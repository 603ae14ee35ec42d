"""Shares of white are areas: against many samples, for edges, corners between cells, slanted and large footprints."""

import numpy as np
import pytest

from synthetic.marker_drawing_sensor_and_occlusion import Footprint, white_share


def sampled(cells, seen, count=600):
    """The same by counting count x count points."""
    u, v = np.meshgrid(*[(np.arange(count) + 0.5) / count - 0.5] * 2)
    i, j = (np.floor(z).astype(int) for z in (seen.X + u * seen.Xu + v * seen.Xv, seen.Y + u * seen.Yu + v * seen.Yv))
    n = len(cells)
    inside = (i >= 0) & (j >= 0) & (i < n) & (j < n)
    return np.where(inside, cells[np.clip(j, 0, n - 1), np.clip(i, 0, n - 1)], 1.0).mean()


@pytest.mark.parametrize("size", [0.02, 0.15, 0.6, 2.5])
def test_shares_are_areas(size):
    rng = np.random.default_rng(int(size * 100))
    cells = np.ascontiguousarray((rng.random((7, 7)) > 0.5).astype(float))
    work, differences = np.empty((4, 12, 2)), []
    for _ in range(60):
        X, Y = rng.integers(-1, 9, 2) + rng.normal(0, 0.3 * size, 2)  # about the corners of cells
        seen = Footprint(X, Y, *(size * rng.normal(size=4)).tolist())
        differences.append(white_share(cells, seen, work) - sampled(cells, seen))
    assert np.abs(differences).max() < 3e-3  # what counting points leaves


def test_a_line_across_is_exact():
    cells, work = np.array([[1.0, 0.0], [1.0, 0.0]]), np.empty((4, 12, 2))
    for at, share in ((0.5, 1.0), (0.9, 1.0), (1.0, 0.5), (1.025, 0.375), (1.1, 0.0), (1.5, 0.0)):
        assert white_share(cells, Footprint(at, 0.7, 0.2, 0.0, 0.0, 0.2), work) == pytest.approx(share, abs=1e-12)
    square_on_its_corner = Footprint(1.05, 0.7, 0.1, 0.1, 0.1, -0.1)
    assert white_share(cells, square_on_its_corner, work) == pytest.approx(0.125, abs=1e-12)
