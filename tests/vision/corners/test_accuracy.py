"""How right corners are, and how right what they say of it."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tests.vision.corners.sheet import NAME, sheet
from tests.vision.exact_pictures import SIZE, camera, picture, quad
from vision import opencv_lens_model as lens
from vision.corners.marker_detection_and_corner_fit import ReadMarkers, detect_markers, fit_read_markers


def test_noise_free_corners_are_exact(design):
    rng = np.random.default_rng(0)
    markers, errors, outward = sheet(design), [], []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(40, 70), tilt=rng.uniform(0, 1.1))
        found = fit_read_markers(
            picture(corners, NAME, k).astype(np.float32),
            camera(),
            markers,
            ReadMarkers([k], (corners + rng.normal(0, 0.5, (4, 2)))[None]),
        )
        error = found.corners[0] - corners
        spoke = corners - corners.mean(axis=0)
        errors.append(error)
        outward.append((error * spoke / np.linalg.norm(spoke, axis=1)[:, None]).sum(axis=1))
    assert np.sqrt(np.mean(np.square(errors))) < 0.003
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.001 and abs(np.mean(outward)) < 0.001


@pytest.mark.slow
def test_light_bowed_over_a_marker_moves_no_corner(design):
    """As where a lens loses light towards its rim: grey that planes alone are laid through makes a square too large by
    0.005 px.
    """
    rng, markers, outward = np.random.default_rng(3), sheet(design), []
    v, u = np.mgrid[:SIZE, :SIZE] / (SIZE / 2) - 1
    for k in range(6):
        corners = quad(rng, side=90)
        image = picture(corners, NAME, k) * (1 - 0.1 * u**2 - 0.05 * v**2 + 0.03 * u * v)
        error = (
            fit_read_markers(image.astype(np.float32), camera(), markers, ReadMarkers([k], corners[None])).corners[0]
            - corners
        )
        spoke = corners - corners.mean(axis=0)
        outward += list((error * spoke / np.linalg.norm(spoke, axis=1)[:, None]).sum(axis=1))
    assert abs(np.mean(outward)) < 0.0005, np.mean(outward)


@pytest.mark.slow
def test_perspective_moves_no_corner(design):
    """Cells of a tilted marker grow towards the camera; an edge's distance guessed from where a pixel lies shifts all
    edges alike.
    """
    rng, markers, errors = np.random.default_rng(4), sheet(design), []
    for k in range(12):
        near, far, tall = 100.0, 78.0, 24.0
        corners = (
            np.array([[-far, -tall], [far, -tall], [near, tall], [-near, tall]]) / 2
            + SIZE / 2
            + rng.uniform(-0.5, 0.5, 2)
        )
        errors.append(
            fit_read_markers(
                picture(corners, NAME, k, blur=0.8).astype(np.float32),
                camera(),
                markers,
                ReadMarkers([k], corners[None]),
            ).corners[0]
            - corners
        )
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.0008, np.mean(errors, axis=(0, 1))


def test_covariance_is_the_scatter(design):
    rng = np.random.default_rng(1)
    markers, chi2 = sheet(design), []
    for k in range(4):
        corners = quad(rng, tilt=0.6)
        clean = picture(corners, NAME, k)
        for _ in range(60):
            noisy = (clean + rng.normal(0, 2.5, clean.shape)).astype(np.float32)
            found = fit_read_markers(noisy, camera(), markers, ReadMarkers([k], corners[None]))
            e = (found.corners[0] - corners).ravel()
            chi2.append(e @ np.linalg.solve(found.covariance[0], e))
            assert found.noise[0] == pytest.approx(2.5, rel=0.15)
    assert np.mean(chi2) == pytest.approx(8, rel=0.1)


def test_edges_bend_with_the_lens(design):
    """A strong lens curves the edges of a marker; corners stay where the lens puts them."""
    bent = camera(distortion=(-0.6, 0, 0, 0, 0))
    corners = quad(np.random.default_rng(2), side=100, tilt=0.3)
    flat = picture(corners, NAME, 3, blur=0.8)
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1).astype(float)
    ideal = lens.undistort(grid, bent.matrix, bent.distortion) * 900 + SIZE / 2
    image = map_coordinates(flat, [ideal[..., 1], ideal[..., 0]], order=3, mode="nearest").astype(
        np.float32
    )  # cv2.remap rounds to 1/32 px
    expected = lens.project(
        np.concatenate([(corners - SIZE / 2) / 900, np.ones((4, 1))], axis=1), bent.matrix, bent.distortion
    )
    found = fit_read_markers(image, bent, sheet(design), ReadMarkers([3], expected[None]))
    np.testing.assert_allclose(found.corners[0], expected, atol=0.006)
    straight = fit_read_markers(image, camera(), sheet(design), ReadMarkers([3], expected[None]))
    assert np.abs(straight.corners[0] - expected).max() > 0.03  # what ignoring the lens would cost


@pytest.mark.slow
def test_what_is_left_of_a_covered_marker_is_as_good_as_it_says(design):
    """A rod in front of a corner or a side, out of its blur nothing may count: pixels there fit well enough, and are
    wrong.
    """
    rng, markers, chi2, off = np.random.default_rng(14), sheet(design), [], []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(30, 60), tilt=rng.uniform(0, 0.8))
        rod = np.zeros((SIZE, SIZE), np.float32)
        at = corners[rng.integers(4)] + rng.uniform(-3, 3, 2)
        along = 200 * np.array([np.cos(angle := rng.uniform(0, np.pi)), np.sin(angle)])
        ends = [tuple((16 * (at + s * along)).astype(int).tolist()) for s in (-1, 1)]
        cv2.line(rod, *ends, 1.0, int(rng.integers(3, 9)), cv2.LINE_AA, 4)
        rod = cv2.GaussianBlur(rod, (0, 0), 0.7)
        image = picture(corners, NAME, k, samples=6) * (1 - rod) + rng.choice([30.0, 90.0, 140.0, 200.0]) * rod
        found = fit_read_markers(
            (image + rng.normal(0, 1, image.shape)).astype(np.float32),
            camera(),
            markers,
            ReadMarkers([k], corners[None]),
        )
        for measured, covariance in zip(found.corners, found.covariance):
            e = (measured - corners).ravel()
            chi2.append(e @ np.linalg.solve(covariance, e))
            off.append(np.abs(e).max())
    assert len(chi2) > 18 and np.mean(chi2) < 11 and np.quantile(off, 0.9) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize(
    "gain", [pytest.param(1.35, marks=pytest.mark.slow), 1.6, pytest.param(2.5, marks=pytest.mark.slow)]
)
def test_over_exposed_markers_are_right_within_their_covariance(design, gain):
    """White is cut off at 255: what is left of the edges says where they are, and how well."""
    rng, chi2 = np.random.default_rng(11), []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(45, 80), tilt=rng.uniform(0, 0.8))
        image = np.clip(
            np.rint(gain * picture(corners, NAME, k, samples=8) + rng.normal(0, 1, (SIZE, SIZE))), 0, 255
        ).astype(np.uint8)
        found = detect_markers(image, camera(), sheet(design))
        assert found.marker.tolist() in ([k], []) and (len(found.marker) or found.left_out or gain > 2)
        for error, C in zip(found.corners - corners, found.covariance):
            chi2.append(error.ravel() @ np.linalg.solve(C, error.ravel()) / 8)
    assert len(chi2) >= 18 and 0.6 < np.mean(chi2) < 1.5


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_rotated_image_shows_the_same_corners_rotated(design, quarters):
    """Corner 0 stays the marker's own first corner, wherever it lies in the image."""
    corners = quad(np.random.default_rng(12), side=70, tilt=0.5)
    image = np.clip(
        np.rint(picture(corners, NAME, 6) + np.random.default_rng(0).normal(0, 1, (SIZE, SIZE))), 0, 255
    ).astype(np.uint8)
    found = detect_markers(np.ascontiguousarray(np.rot90(image, quarters)), camera(), sheet(design))
    turned = corners
    for _ in range(quarters):
        turned = np.stack([turned[:, 1], SIZE - 1 - turned[:, 0]], axis=1)
    assert found.marker.tolist() == [6]
    np.testing.assert_allclose(found.corners[0], turned, atol=0.03)


@pytest.mark.slow
def test_wide_edges_of_small_cells_see_beyond_the_next_cell(design):
    """A cell of 3.6 px under a blur of 1.5 px: without the cells beyond the next ones corners would be off by 0.01 px
    and more.
    """
    rng, markers, errors = np.random.default_rng(15), sheet(design), []
    for k in range(8):
        corners = quad(rng, side=25, tilt=0.4)
        found = fit_read_markers(
            picture(corners, NAME, k, blur=1.5).astype(np.float32), camera(), markers, ReadMarkers([k], corners[None])
        )
        errors += list(found.corners - corners)
    assert len(errors) >= 6 and np.sqrt(np.mean(np.square(errors))) < 0.01


@pytest.mark.slow
def test_what_is_no_noise_is_in_the_covariance(design):
    """Pictures of 8 x 8 rays to the pixel have next to no noise, and edges out of place by more than it."""
    rng, markers, squares = np.random.default_rng(16), sheet(design), []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(50, 100), tilt=rng.uniform(0, 1.1))
        image = picture(corners, NAME, k, blur=0.8, samples=8, sharp=True) + rng.normal(0, 0.5, (SIZE, SIZE))
        found = fit_read_markers(image.astype(np.float32), camera(), markers, ReadMarkers([k], corners[None]))
        for error, C in zip(found.corners - corners, found.covariance):
            squares += [error[c] @ np.linalg.solve(C[2 * c : 2 * c + 2, 2 * c : 2 * c + 2], error[c]) for c in range(4)]
    assert 0.86 < np.mean(np.array(squares) < 5.991) < 0.995
