"""Edge spread functions: plain ones as they should be, and one that is not plain learnt from the images."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from scipy.special import ndtr

from tests.vision.corners.sheet import NAME, sheet
from tests.vision.exact_pictures import SIZE, camera, picture, quad
from vision.corners.blurred_edge_image_model_and_numba_kernels import GRID
from vision.corners.edge_spread_function import PLAIN_EDGE_SPREAD, WIDTHS, empty_residual_profile, learn_edge_spread
from vision.corners.marker_detection_and_corner_fit import ReadMarkers, fit_read_markers


def test_plain_edges_are_odd_and_their_slope_is_theirs():
    share, slope = PLAIN_EDGE_SPREAD.tables[..., 0], PLAIN_EDGE_SPREAD.tables[..., 1]
    np.testing.assert_allclose(share + share[..., ::-1], 1, atol=1e-9)
    np.testing.assert_allclose(np.gradient(share[2:], GRID, axis=-1), slope[2:], atol=2e-3)
    np.testing.assert_allclose(
        share[-1], np.broadcast_to(ndtr(GRID), share[-1].shape), atol=1e-3
    )  # a wide edge is a Gaussian's


def test_a_plain_edge_is_a_gaussian_seen_through_pixels():
    """An upright edge, by averaging the Gaussian over each pixel."""
    blur = np.sqrt(WIDTHS[3] ** 2 - 1 / 12)
    fine = (np.arange(2000) + 0.5) / 2000 - 0.5
    expected = ndtr((GRID[:, None] * WIDTHS[3] + fine) / blur).mean(axis=1)
    np.testing.assert_allclose(PLAIN_EDGE_SPREAD.tables[3, 0, :, 0], expected, atol=2e-5)


@pytest.mark.slow
def test_what_a_camera_does_to_edges_is_learnt(design):
    """Sharpened images: what is learnt halves what the fits leave, and corners do not get worse for it."""
    rng = np.random.default_rng(0)
    markers, images, truth = sheet(design), [], []
    for k in range(10):
        corners = quad(rng, side=90, tilt=rng.uniform(0, 0.8))
        sharp = picture(corners, NAME, k, blur=0.5)
        for axis in (0, 1):
            sharp = correlate1d(sharp, [-0.1, 1.2, -0.1], axis=axis)
        images.append((sharp + rng.normal(0, 0.3, (SIZE, SIZE))).astype(np.float32))
        truth.append(corners)

    def fit(spread):
        profile = empty_residual_profile()
        found = [
            fit_read_markers(image, camera(), markers, ReadMarkers([k], corners[None]), spread=spread, profile=profile)
            for k, (image, corners) in enumerate(zip(images, truth))
        ]
        error = np.concatenate([f.corners[0] - corners for f, corners in zip(found, truth)])
        return (
            profile,
            np.median([f.noise[0] for f in found]),
            np.sqrt(np.mean(error**2)),
            np.median([f.blur[0] for f in found]),
        )

    spread = PLAIN_EDGE_SPREAD
    _, noise_before, error_before, _ = fit(spread)
    for _ in range(4):
        profile, _, _, width = fit(spread)
        spread = learn_edge_spread(spread, profile, width)
    _, noise_after, error_after, _ = fit(spread)
    assert noise_after < 0.5 * noise_before and error_after < error_before


def test_too_few_pixels_teach_nothing():
    profile = empty_residual_profile()
    profile[0, 10] = 5, 1.0, 1.0
    assert learn_edge_spread(PLAIN_EDGE_SPREAD, profile, 0.7) is PLAIN_EDGE_SPREAD
