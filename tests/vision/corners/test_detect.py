"""Corners: exact on exact pictures, honest about noise, robust to what covers them, and a reason where there are none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from rig.design import DICTIONARIES, Marker, Target
from rig.pose import pose
from tests.vision.pictures import SIZE, camera, picture, quad
from vision import lens
from vision.corners.detect import Read, detect, place
from vision.predict import expected
from vision.targets import marker_map

NAME = "DICT_5X5_100"


def sheet(design, dictionary=NAME, ids=range(30), margin=0.9):
    """A marker map of loose sheets of one dictionary."""
    cells = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).markerSize + 2
    listed = tuple(Marker(i, 1.0, pose([0, 0, 0], [0, 0, 0]), margin / cells) for i in ids)
    return marker_map(replace(design, targets=(Target("t", "platform", dictionary, listed=listed),)))


def test_noise_free_corners_are_exact(design):
    rng = np.random.default_rng(0)
    markers, errors, outward = sheet(design), [], []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(40, 70), tilt=rng.uniform(0, 1.1))
        found = place(picture(corners, NAME, k).astype(np.float32), camera(), markers, Read([k], (corners + rng.normal(0, 0.5, (4, 2)))[None]))
        error = found.corners[0] - corners
        spoke = corners - corners.mean(axis=0)
        errors.append(error)
        outward.append((error * spoke / np.linalg.norm(spoke, axis=1)[:, None]).sum(axis=1))
    assert np.sqrt(np.mean(np.square(errors))) < 0.003
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.001 and abs(np.mean(outward)) < 0.001


def test_light_bowed_over_a_marker_moves_no_corner(design):
    """As where a lens loses light towards its rim: grey that planes alone are laid through makes a square too large by 0.005 px."""
    rng, markers, outward = np.random.default_rng(3), sheet(design), []
    v, u = np.mgrid[:SIZE, :SIZE] / (SIZE / 2) - 1
    for k in range(6):
        corners = quad(rng, side=90)
        image = picture(corners, NAME, k) * (1 - 0.1 * u**2 - 0.05 * v**2 + 0.03 * u * v)
        error = place(image.astype(np.float32), camera(), markers, Read([k], corners[None])).corners[0] - corners
        spoke = corners - corners.mean(axis=0)
        outward += list((error * spoke / np.linalg.norm(spoke, axis=1)[:, None]).sum(axis=1))
    assert abs(np.mean(outward)) < 0.0005, np.mean(outward)


def test_perspective_moves_no_corner(design):
    """Cells of a tilted marker grow towards the camera; an edge's distance guessed from where a pixel lies shifts all edges alike."""
    rng, markers, errors = np.random.default_rng(4), sheet(design), []
    for k in range(12):
        near, far, tall = 100.0, 78.0, 24.0
        corners = np.array([[-far, -tall], [far, -tall], [near, tall], [-near, tall]]) / 2 + SIZE / 2 + rng.uniform(-0.5, 0.5, 2)
        errors.append(place(picture(corners, NAME, k, blur=0.8).astype(np.float32), camera(), markers, Read([k], corners[None])).corners[0] - corners)
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.0008, np.mean(errors, axis=(0, 1))


def test_covariance_is_the_scatter(design):
    rng = np.random.default_rng(1)
    markers, chi2 = sheet(design), []
    for k in range(4):
        corners = quad(rng, tilt=0.6)
        clean = picture(corners, NAME, k)
        for _ in range(60):
            noisy = (clean + rng.normal(0, 2.5, clean.shape)).astype(np.float32)
            found = place(noisy, camera(), markers, Read([k], corners[None]))
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
    image = map_coordinates(flat, [ideal[..., 1], ideal[..., 0]], order=3, mode="nearest").astype(np.float32)  # cv2.remap rounds to 1/32 px
    expected = lens.project(np.concatenate([(corners - SIZE / 2) / 900, np.ones((4, 1))], axis=1), bent.matrix, bent.distortion)
    found = place(image, bent, sheet(design), Read([3], expected[None]))
    np.testing.assert_allclose(found.corners[0], expected, atol=0.006)
    straight = place(image, camera(), sheet(design), Read([3], expected[None]))
    assert np.abs(straight.corners[0] - expected).max() > 0.03  # what ignoring the lens would cost


@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_5X5_1000", "DICT_6X6_250", "DICT_7X7_50", "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12",
                                        "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11"])
def test_every_family_is_read(design, dictionary):
    assert dictionary in DICTIONARIES
    corners = quad(np.random.default_rng(3), side=80, tilt=0.4)
    image = np.clip(picture(corners, dictionary, 7) + np.random.default_rng(0).normal(0, 1, (SIZE, SIZE)), 0, 255).astype(np.uint8)
    found = detect(image, camera(), sheet(design, dictionary, range(8)))
    assert found.marker.tolist() == [7]
    np.testing.assert_allclose(found.corners[0], corners, atol=0.05)


def test_what_covers_a_marker_does_not_pull_it(design):
    corners = quad(np.random.default_rng(4), side=70, tilt=0.2)
    image = picture(corners, NAME, 5).astype(np.float32)
    middle = (corners[1] + corners[2]) / 2
    cv2.circle(image, tuple(int(v) for v in middle), 7, 140.0, -1)
    found = place(image + np.random.default_rng(0).normal(0, 1, image.shape).astype(np.float32), camera(), sheet(design), Read([5], corners[None]))
    np.testing.assert_allclose(found.corners[0], corners, atol=0.06)
    image[:, : SIZE // 2] = 100
    gone = place(image, camera(), sheet(design), Read([5], corners[None]))
    assert not len(gone.marker) and gone.left_out[0][0] == 5


def test_what_is_left_of_a_covered_marker_is_as_good_as_it_says(design):
    """A rod in front of a corner or a side, out of its blur nothing may count: pixels there fit well enough, and are wrong."""
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
        found = place((image + rng.normal(0, 1, image.shape)).astype(np.float32), camera(), markers, Read([k], corners[None]))
        for measured, covariance in zip(found.corners, found.covariance):
            e = (measured - corners).ravel()
            chi2.append(e @ np.linalg.solve(covariance, e))
            off.append(np.abs(e).max())
    assert len(chi2) > 18 and np.mean(chi2) < 11 and np.quantile(off, 0.9) < 0.06


@pytest.mark.parametrize("spoil, says", [
    (lambda image: image * 0 + 90, "white is no brighter|contrast|pixels|settle|determined|lost"),
    (lambda image: 210 - image, "white is no brighter"),
    (lambda image: np.random.default_rng(0).normal(100, 60, image.shape), "lost in noise|not this marker|settle|brighter|turned|left the place"),
])
def test_what_is_no_marker_gets_a_reason(design, spoil, says):
    import re

    corners = quad(np.random.default_rng(5))
    found = place(spoil(picture(corners, NAME, 1)).astype(np.float32), camera(), sheet(design), Read([1], corners[None]))
    assert not len(found.marker) and re.search(says, found.left_out[0][1]), found.left_out


def test_another_marker_is_not_taken_for_it(design):
    corners = quad(np.random.default_rng(6))
    found = place(picture(corners, NAME, 1).astype(np.float32), camera(), sheet(design), Read([2], corners[None]))
    assert not len(found.marker)


def test_a_marker_too_small_is_left_out_with_its_size(design):
    corners = quad(np.random.default_rng(7), side=14)
    found = place(picture(corners, NAME, 1).astype(np.float32), camera(), sheet(design), Read([1], corners[None]))
    assert not len(found.marker) and "too small" in found.left_out[0][1]


def test_an_identity_seen_twice_is_not_averaged(design):
    rng = np.random.default_rng(8)
    one, two = (picture(quad(rng, side=60), NAME, 4) for _ in range(2))
    wide = camera(size=2 * SIZE)
    image = np.full((2 * SIZE, 2 * SIZE), 70.0)
    image[:SIZE, :SIZE], image[SIZE:, SIZE:] = one, two
    found = detect(image.astype(np.uint8), wide, sheet(design))
    assert not len(found.marker) and found.left_out == ((4, "seen 2 times in one image", True),)


@pytest.mark.parametrize("form", ["colour", "16 bit", "alpha", "12 in 16 bit"])
def test_every_kind_of_image_is_read(design, form):
    corners = quad(np.random.default_rng(9), side=70)
    clean = picture(corners, NAME, 6)
    image = {"colour": np.repeat(clean[..., None], 3, axis=2).astype(np.uint8), "alpha": np.repeat(clean[..., None], 4, axis=2).astype(np.uint8),
             "16 bit": (clean * 257).astype(np.uint16), "12 in 16 bit": (clean * 16).astype(np.uint16)}[form]
    found = detect(image, camera(), sheet(design))
    assert found.marker.tolist() == [6]
    np.testing.assert_allclose(found.corners[0], corners, atol=0.03)


def test_a_kind_of_image_that_is_none_is_refused(design):
    with pytest.raises(ValueError, match="8 or 16 bit"):
        detect(np.zeros((10, 10), np.float32), camera(), sheet(design))


def test_an_empty_image_shows_nothing(design):
    found = detect(np.full((SIZE, SIZE), 80, np.uint8), camera(), sheet(design))
    assert found.corners.shape == (0, 4, 2) and found.covariance.shape == (0, 8, 8)


def cube_scene(design, at, dictionary=NAME):
    """(camera, marker map, pose expected, image) of one sheet on the platform, drawn where a pose puts it."""
    view = camera()
    listed = (Marker(3, 0.06, pose([0, 0, 0.9], [np.pi - 0.4, 0.2, 0.3]), 0.008), Marker(4, 0.06, pose([0.5, 0, 0.9], [np.pi, 0, 0]), 0.008))
    markers = marker_map(replace(design, targets=(Target("t", "platform", dictionary, listed=listed),)))
    _, (corners,) = expected(view, at, markers)
    image = picture(corners, dictionary, 3) + np.random.default_rng(0).normal(0, 1, (SIZE, SIZE))
    return view, markers, corners, np.clip(image, 0, 255).astype(np.uint8)


def test_where_a_pose_is_expected_only_its_places_are_read(design, monkeypatch):
    here = pose([0, 0, 0], [0, 0, 0])
    view, markers, corners, image = cube_scene(design, here)
    whole = detect(image, view, markers)
    monkeypatch.setattr("vision.corners.detect.dictionary_reader", lambda name: pytest.fail("the whole image was searched"))
    for offset in ([0, 0, 0], [0.003, -0.003, 0]):  # 3 px
        found = detect(image, view, markers, T_base_platform=pose(offset, [0, 0, 0]))
        assert found.marker.tolist() == [3]
        np.testing.assert_allclose(found.corners, whole.corners, atol=0.01)


@pytest.mark.parametrize("spoil", ["another pose", "another marker", "nothing there"])
def test_what_is_not_where_it_is_expected_is_searched_for(design, spoil):
    here = pose([0, 0, 0], [0, 0, 0])
    view, markers, corners, image = cube_scene(design, here)
    if spoil == "another pose":
        found = detect(image, view, markers, T_base_platform=pose([0.03, 0.02, 0], [0, 0, 0.2]))
        assert found.marker.tolist() == [3]
        np.testing.assert_allclose(found.corners[0], corners, atol=0.05)
    elif spoil == "another marker":
        image = np.clip(picture(corners, NAME, 4), 0, 255).astype(np.uint8)
        found = detect(image, view, markers, T_base_platform=here)
        assert found.marker.tolist() == [4]
    else:
        assert not len(detect(np.full_like(image, 80), view, markers, T_base_platform=here).marker)


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (3, 3)])
def test_images_too_small_for_anything_show_nothing(design, shape):
    assert not len(detect(np.full(shape, 90, np.uint8), camera(), sheet(design)).marker)


@pytest.mark.slow
def test_no_identity_in_noise(design):
    """10 000 images of noise, white and smooth, of many contrasts: no marker is placed."""
    rng = np.random.default_rng(0)
    markers, view = sheet(design, ids=range(100)), camera(size=160)
    for k in range(10_000):
        image = cv2.GaussianBlur(rng.normal(0, 1, (160, 160)), (0, 0), rng.uniform(0.3, 6)) if k % 3 else rng.normal(0, 1, (160, 160))
        image = np.clip(128 + rng.uniform(20, 120) * image / image.std(), 0, 255).astype(np.uint8)
        found = detect(image, view, markers)
        assert not len(found.marker), (k, found.marker)


@pytest.mark.parametrize("spoil, atol", [
    (lambda image, rng: cv2.GaussianBlur(image, (0, 0), 1.3), 0.05),
    (lambda image, rng: image * 0.12 + 3 + rng.normal(0, 0.5, image.shape), 0.1),
    (lambda image, rng: image * 0.5 + 60 * (1 + np.sin(2.1 * np.arange(image.shape[1]))) / 2, 0.4),  # the stripes of a screen
])
def test_blurred_dark_and_striped_markers_are_right_or_left_out_with_a_reason(design, spoil, atol):
    rng = np.random.default_rng(10)
    corners = quad(rng, side=70, tilt=0.3)
    image = np.clip(np.rint(spoil(picture(corners, NAME, 6), rng)), 0, 255).astype(np.uint8)
    found = detect(image, camera(), sheet(design))
    if len(found.marker):
        assert found.marker.tolist() == [6]
        np.testing.assert_allclose(found.corners[0], corners, atol=atol)
    else:
        assert found.left_out and found.left_out[0][0] == 6


@pytest.mark.parametrize("gain", [pytest.param(1.35, marks=pytest.mark.slow), 1.6, pytest.param(2.5, marks=pytest.mark.slow)])
def test_over_exposed_markers_are_right_within_their_covariance(design, gain):
    """White is cut off at 255: what is left of the edges says where they are, and how well."""
    rng, chi2 = np.random.default_rng(11), []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(45, 80), tilt=rng.uniform(0, 0.8))
        image = np.clip(np.rint(gain * picture(corners, NAME, k, samples=8) + rng.normal(0, 1, (SIZE, SIZE))), 0, 255).astype(np.uint8)
        found = detect(image, camera(), sheet(design))
        assert found.marker.tolist() in ([k], []) and (len(found.marker) or found.left_out or gain > 2)
        for error, C in zip(found.corners - corners, found.covariance):
            chi2.append(error.ravel() @ np.linalg.solve(C, error.ravel()) / 8)
    assert len(chi2) >= 18 and 0.6 < np.mean(chi2) < 1.5


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_rotated_image_shows_the_same_corners_rotated(design, quarters):
    """Corner 0 stays the marker's own first corner, wherever it lies in the image."""
    corners = quad(np.random.default_rng(12), side=70, tilt=0.5)
    image = np.clip(np.rint(picture(corners, NAME, 6) + np.random.default_rng(0).normal(0, 1, (SIZE, SIZE))), 0, 255).astype(np.uint8)
    found = detect(np.ascontiguousarray(np.rot90(image, quarters)), camera(), sheet(design))
    turned = corners
    for _ in range(quarters):
        turned = np.stack([turned[:, 1], SIZE - 1 - turned[:, 0]], axis=1)
    assert found.marker.tolist() == [6]
    np.testing.assert_allclose(found.corners[0], turned, atol=0.03)


@pytest.mark.parametrize("flip", [0, 1])
def test_a_mirrored_image_shows_no_marker(design, flip):
    image = np.clip(picture(quad(np.random.default_rng(13), side=70), NAME, 6), 0, 255).astype(np.uint8)
    assert detect(image, camera(), sheet(design)).marker.tolist() == [6]
    assert not len(detect(np.ascontiguousarray(np.flip(image, flip)), camera(), sheet(design, ids=range(100))).marker)


@pytest.mark.parametrize("pitch", [1.7, 2.6, 5.3])
def test_a_marker_on_a_screen_is_right_or_left_out_with_a_reason(design, pitch):
    """A screen's pixels, of three coloured stripes with dark gaps between them, photographed askew: moire."""
    rng, fine = np.random.default_rng(14), 8
    corners = quad(rng, side=80, tilt=0.3)
    u, v = np.meshgrid(*[(np.arange(SIZE * fine) + 0.5) / fine] * 2)
    x, y = (u * np.cos(0.1) + v * np.sin(0.1)) / pitch, (v * np.cos(0.1) - u * np.sin(0.1)) / pitch
    open_ = (np.mod(y, 1) < 0.85)[..., None] & (np.abs(np.mod(x[..., None] - np.array([0.17, 0.5, 0.83]) + 0.5, 1) - 0.5) < 0.14)
    screen = open_.reshape(SIZE, fine, SIZE, fine, 3).mean(axis=(1, 3)) / 0.24
    image = np.clip(np.rint(picture(corners, NAME, 6, white=150.0)[..., None] * screen + rng.normal(0, 1, screen.shape)), 0, 255).astype(np.uint8)
    found = detect(image, camera(), sheet(design))
    if len(found.marker):
        assert found.marker.tolist() == [6]
        assert np.abs(found.corners[0] - corners).max() < 0.25
    else:
        assert not found.left_out or found.left_out[0][0] == 6


@pytest.mark.slow
def test_wide_edges_of_small_cells_see_beyond_the_next_cell(design):
    """A cell of 3.6 px under a blur of 1.5 px: without the cells beyond the next ones corners would be off by 0.01 px and more."""
    rng, markers, errors = np.random.default_rng(15), sheet(design), []
    for k in range(8):
        corners = quad(rng, side=25, tilt=0.4)
        found = place(picture(corners, NAME, k, blur=1.5).astype(np.float32), camera(), markers, Read([k], corners[None]))
        errors += list(found.corners - corners)
    assert len(errors) >= 6 and np.sqrt(np.mean(np.square(errors))) < 0.01


def test_what_is_no_noise_is_in_the_covariance(design):
    """Pictures of 8 x 8 rays to the pixel have next to no noise, and edges out of place by more than it."""
    rng, markers, squares = np.random.default_rng(16), sheet(design), []
    for k in range(24):
        corners = quad(rng, side=rng.uniform(50, 100), tilt=rng.uniform(0, 1.1))
        image = picture(corners, NAME, k, blur=0.8, samples=8, sharp=True) + rng.normal(0, 0.5, (SIZE, SIZE))
        found = place(image.astype(np.float32), camera(), markers, Read([k], corners[None]))
        for error, C in zip(found.corners - corners, found.covariance):
            squares += [error[c] @ np.linalg.solve(C[2 * c : 2 * c + 2, 2 * c : 2 * c + 2], error[c]) for c in range(4)]
    assert 0.86 < np.mean(np.array(squares) < 5.991) < 0.995
