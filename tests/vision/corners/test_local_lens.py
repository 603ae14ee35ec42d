"""A lens near one marker: as true as the whole lens, there and back."""

import numpy as np
import pytest

from rig.model.design import Camera
from rig.model.pose import pose
from vision import opencv_lens_model as lens
from vision.corners import local_lens_and_fit_start

LENSES = [(-0.1, 0.08, 0, 0, 0), (-0.25, 0.1, 0.0004, -0.0003, 0), (-0.3, 0.12, 0.001, -0.001, -0.02)]
QUADS = np.array(
    [[[949, 795], [1044, 875], [931, 930], [840, 843]], [[120, 30], [250, 40], [240, 160], [115, 150]]], float
)


@pytest.mark.parametrize("distortion", LENSES)
@pytest.mark.parametrize("quad", QUADS)
def test_it_is_the_lens_along_the_sides_of_a_large_marker(distortion, quad):
    camera = Camera(
        "c",
        1280,
        1024,
        [[1640.0, 0, 640], [0, 1640, 512], [0, 0, 1]],
        np.array(distortion, float),
        pose([0, 0, 0], [0, 0, 0]),
    )
    middle = quad.mean(axis=0)
    scale = np.abs(quad - middle).max()
    terms = np.empty((1, 2, local_lens_and_fit_start.TERMS))
    local_lens_and_fit_start.fill_local_lens_polynomials(
        local_lens_and_fit_start.ideal_coordinate_table(camera), np.array([[*middle, scale]]), terms
    )
    share = np.linspace(0, 1, 9)[:, None]
    along = np.concatenate([a + share * (b - a) for a, b in zip(quad, np.roll(quad, -1, axis=0))])
    exact = lens.undistort(along, camera.matrix, camera.distortion) - lens.undistort(
        middle, camera.matrix, camera.distortion
    )
    local = (along - middle) / scale
    near = np.array([local_lens_and_fit_start.local_pixel_to_local_ideal(terms[0], u, v) for u, v in local])
    away = near * scale - exact * 1640  # the same everywhere is no matter: it is taken back with the corners
    assert np.abs(away - away[::9].mean(axis=0)).max() < 3e-4  # px
    assert (
        np.abs(away.mean(axis=0) - away[::9].mean(axis=0)).max() < 4e-5
    )  # px that its corners would be off by; 5e-4 by cubic polynomials
    back = np.array(
        [
            local_lens_and_fit_start.local_ideal_to_local_pixel_and_derivatives(terms[0], x, y, 0.0, 0.0)[:2]
            for x, y in near
        ]
    )
    assert np.abs(back - local).max() < 1e-9


def test_how_it_changes_is_its_derivative():
    terms, step = np.random.default_rng(0).normal(size=(2, local_lens_and_fit_start.TERMS)) * 0.02, 1e-6
    terms[0, 1] = terms[1, 2] = 1.0
    at = local_lens_and_fit_start.local_pixel_to_local_ideal(terms, 0.3, -0.4)
    found = local_lens_and_fit_start.local_ideal_to_local_pixel_and_derivatives(terms, *at, 0.3, -0.4)

    def ideal(u, v):
        return np.array(local_lens_and_fit_start.local_pixel_to_local_ideal(terms, u, v))

    differences = np.stack(
        [(ideal(0.3 + du, -0.4 + dv) - ideal(0.3 - du, -0.4 - dv)) / (2 * step) for du, dv in ((step, 0), (0, step))],
        axis=1,
    )
    assert np.abs(np.array([[found.ux, found.uy], [found.vx, found.vy]]) @ differences - np.eye(2)).max() < 1e-7
