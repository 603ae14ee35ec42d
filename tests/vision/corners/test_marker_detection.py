"""Markers read: of every family, in every kind of image, where one is expected; and a reason where there is none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rig.model.design import DICTIONARIES, Marker, Target
from rig.model.pose import pose
from tests.vision.corners.sheet import NAME, sheet
from tests.vision.exact_pictures import SIZE, camera, picture, quad
from vision.corners.marker_detection_and_corner_fit import ReadMarkers, detect_markers, fit_read_markers
from vision.marker_corner_prediction import expected_marker_rows_and_corners_in_image, marker_map


@pytest.mark.parametrize(
    "dictionary",
    [
        "DICT_4X4_50",
        "DICT_5X5_1000",
        "DICT_6X6_250",
        "DICT_7X7_50",
        "DICT_ARUCO_ORIGINAL",
        "DICT_ARUCO_MIP_36h12",
        "DICT_APRILTAG_16h5",
        "DICT_APRILTAG_25h9",
        "DICT_APRILTAG_36h10",
        "DICT_APRILTAG_36h11",
    ],
)
def test_every_family_is_read(design, dictionary):
    assert dictionary in DICTIONARIES
    corners = quad(np.random.default_rng(3), side=80, tilt=0.4)
    image = np.clip(
        picture(corners, dictionary, 7) + np.random.default_rng(0).normal(0, 1, (SIZE, SIZE)), 0, 255
    ).astype(np.uint8)
    found = detect_markers(image, camera(), sheet(design, dictionary, range(8)))
    assert found.marker.tolist() == [7]
    np.testing.assert_allclose(found.corners[0], corners, atol=0.05)


def test_what_covers_a_marker_does_not_pull_it(design):
    corners = quad(np.random.default_rng(4), side=70, tilt=0.2)
    image = picture(corners, NAME, 5).astype(np.float32)
    middle = (corners[1] + corners[2]) / 2
    cv2.circle(image, tuple(int(v) for v in middle), 7, 140.0, -1)
    found = fit_read_markers(
        image + np.random.default_rng(0).normal(0, 1, image.shape).astype(np.float32),
        camera(),
        sheet(design),
        ReadMarkers([5], corners[None]),
    )
    np.testing.assert_allclose(found.corners[0], corners, atol=0.06)
    image[:, : SIZE // 2] = 100
    gone = fit_read_markers(image, camera(), sheet(design), ReadMarkers([5], corners[None]))
    assert not len(gone.marker) and gone.left_out[0][0] == 5


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda image: image * 0 + 90, "white is no brighter|contrast|pixels|settle|determined|lost"),
        (lambda image: 210 - image, "white is no brighter"),
        (
            lambda image: np.random.default_rng(0).normal(100, 60, image.shape),
            "lost in noise|not this marker|settle|brighter|turned|left the place",
        ),
    ],
)
def test_what_is_no_marker_gets_a_reason(design, spoil, says):
    import re

    corners = quad(np.random.default_rng(5))
    found = fit_read_markers(
        spoil(picture(corners, NAME, 1)).astype(np.float32), camera(), sheet(design), ReadMarkers([1], corners[None])
    )
    assert not len(found.marker) and re.search(says, found.left_out[0][1]), found.left_out


def test_another_marker_is_not_taken_for_it(design):
    corners = quad(np.random.default_rng(6))
    found = fit_read_markers(
        picture(corners, NAME, 1).astype(np.float32), camera(), sheet(design), ReadMarkers([2], corners[None])
    )
    assert not len(found.marker)


def test_a_marker_too_small_is_left_out_with_its_size(design):
    corners = quad(np.random.default_rng(7), side=14)
    found = fit_read_markers(
        picture(corners, NAME, 1).astype(np.float32), camera(), sheet(design), ReadMarkers([1], corners[None])
    )
    assert not len(found.marker) and "too small" in found.left_out[0][1]


def test_an_identity_seen_twice_is_not_averaged(design):
    rng = np.random.default_rng(8)
    one, two = (picture(quad(rng, side=60), NAME, 4) for _ in range(2))
    wide = camera(size=2 * SIZE)
    image = np.full((2 * SIZE, 2 * SIZE), 70.0)
    image[:SIZE, :SIZE], image[SIZE:, SIZE:] = one, two
    found = detect_markers(image.astype(np.uint8), wide, sheet(design))
    assert not len(found.marker) and found.left_out == ((4, "seen 2 times in one image", True),)


@pytest.mark.parametrize("form", ["colour", "16 bit", "alpha", "12 in 16 bit"])
def test_every_kind_of_image_is_read(design, form):
    corners = quad(np.random.default_rng(9), side=70)
    clean = picture(corners, NAME, 6)
    image = {
        "colour": np.repeat(clean[..., None], 3, axis=2).astype(np.uint8),
        "alpha": np.repeat(clean[..., None], 4, axis=2).astype(np.uint8),
        "16 bit": (clean * 257).astype(np.uint16),
        "12 in 16 bit": (clean * 16).astype(np.uint16),
    }[form]
    found = detect_markers(image, camera(), sheet(design))
    assert found.marker.tolist() == [6]
    np.testing.assert_allclose(found.corners[0], corners, atol=0.03)


def test_a_kind_of_image_that_is_none_is_refused(design):
    with pytest.raises(ValueError, match="8 or 16 bit"):
        detect_markers(np.zeros((10, 10), np.float32), camera(), sheet(design))


def test_an_empty_image_shows_nothing(design):
    found = detect_markers(np.full((SIZE, SIZE), 80, np.uint8), camera(), sheet(design))
    assert found.corners.shape == (0, 4, 2) and found.covariance.shape == (0, 8, 8)


def cube_scene(design, at, dictionary=NAME):
    """(camera, marker map, pose expected, image) of one sheet on the platform, drawn where a pose puts it."""
    view = camera()
    listed = (
        Marker(3, 0.06, pose([0, 0, 0.9], [np.pi - 0.4, 0.2, 0.3]), 0.008),
        Marker(4, 0.06, pose([0.5, 0, 0.9], [np.pi, 0, 0]), 0.008),
    )
    markers = marker_map(replace(design, targets=(Target("t", "platform", dictionary, listed=listed),)))
    _, (corners,) = expected_marker_rows_and_corners_in_image(view, at, markers)
    image = picture(corners, dictionary, 3) + np.random.default_rng(0).normal(0, 1, (SIZE, SIZE))
    return view, markers, corners, np.clip(image, 0, 255).astype(np.uint8)


def test_where_a_pose_is_expected_only_its_places_are_read(design, monkeypatch):
    here = pose([0, 0, 0], [0, 0, 0])
    view, markers, corners, image = cube_scene(design, here)
    whole = detect_markers(image, view, markers)
    monkeypatch.setattr(
        "vision.corners.marker_detection_and_corner_fit.read_markers",
        lambda *_: pytest.fail("the whole image was searched"),
    )
    for offset in ([0, 0, 0], [0.003, -0.003, 0]):  # 3 px
        found = detect_markers(image, view, markers, T_base_platform=pose(offset, [0, 0, 0]))
        assert found.marker.tolist() == [3]
        np.testing.assert_allclose(found.corners, whole.corners, atol=0.01)


@pytest.mark.parametrize("spoil", ["another pose", "another marker", "nothing there"])
def test_what_is_not_where_it_is_expected_is_searched_for(design, spoil):
    here = pose([0, 0, 0], [0, 0, 0])
    view, markers, corners, image = cube_scene(design, here)
    if spoil == "another pose":
        found = detect_markers(image, view, markers, T_base_platform=pose([0.03, 0.02, 0], [0, 0, 0.2]))
        assert found.marker.tolist() == [3]
        np.testing.assert_allclose(found.corners[0], corners, atol=0.05)
    elif spoil == "another marker":
        image = np.clip(picture(corners, NAME, 4), 0, 255).astype(np.uint8)
        found = detect_markers(image, view, markers, T_base_platform=here)
        assert found.marker.tolist() == [4]
    else:
        assert not len(detect_markers(np.full_like(image, 80), view, markers, T_base_platform=here).marker)


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (3, 3)])
def test_images_too_small_for_anything_show_nothing(design, shape):
    assert not len(detect_markers(np.full(shape, 90, np.uint8), camera(), sheet(design)).marker)


@pytest.mark.slow
def test_no_identity_in_noise(design):
    """10 000 images of noise, white and smooth, of many contrasts: no marker is placed."""
    rng = np.random.default_rng(0)
    markers, view = sheet(design, ids=range(100)), camera(size=160)
    for k in range(10_000):
        image = (
            cv2.GaussianBlur(rng.normal(0, 1, (160, 160)), (0, 0), rng.uniform(0.3, 6))
            if k % 3
            else rng.normal(0, 1, (160, 160))
        )
        image = np.clip(128 + rng.uniform(20, 120) * image / image.std(), 0, 255).astype(np.uint8)
        found = detect_markers(image, view, markers)
        assert not len(found.marker), (k, found.marker)


@pytest.mark.parametrize(
    "spoil, atol",
    [
        (lambda image, rng: cv2.GaussianBlur(image, (0, 0), 1.3), 0.05),
        (lambda image, rng: image * 0.12 + 3 + rng.normal(0, 0.5, image.shape), 0.1),
        (
            lambda image, rng: image * 0.5 + 60 * (1 + np.sin(2.1 * np.arange(image.shape[1]))) / 2,
            0.4,
        ),  # the stripes of a screen
    ],
)
def test_blurred_dark_and_striped_markers_are_right_or_left_out_with_a_reason(design, spoil, atol):
    rng = np.random.default_rng(10)
    corners = quad(rng, side=70, tilt=0.3)
    image = np.clip(np.rint(spoil(picture(corners, NAME, 6), rng)), 0, 255).astype(np.uint8)
    found = detect_markers(image, camera(), sheet(design))
    if len(found.marker):
        assert found.marker.tolist() == [6]
        np.testing.assert_allclose(found.corners[0], corners, atol=atol)
    else:
        assert found.left_out and found.left_out[0][0] == 6


def test_markers_that_the_rig_has_not_are_passed_over_and_its_own_keep_their_identities(design):
    corners = quad(np.random.default_rng(17), side=70)
    image = np.clip(picture(corners, NAME, 6), 0, 255).astype(np.uint8)
    assert not len(detect_markers(image, camera(), sheet(design, ids=[0, 3, 11, 60])).marker)
    assert detect_markers(image, camera(), sheet(design, ids=[60, 6, 3])).marker.tolist() == [6]


@pytest.mark.parametrize("flip", [0, 1])
def test_a_mirrored_image_shows_no_marker(design, flip):
    image = np.clip(picture(quad(np.random.default_rng(13), side=70), NAME, 6), 0, 255).astype(np.uint8)
    assert detect_markers(image, camera(), sheet(design)).marker.tolist() == [6]
    assert not len(
        detect_markers(np.ascontiguousarray(np.flip(image, flip)), camera(), sheet(design, ids=range(100))).marker
    )


@pytest.mark.parametrize(
    "pitch", [pytest.param(1.7, marks=pytest.mark.slow), 2.6, pytest.param(5.3, marks=pytest.mark.slow)]
)
def test_a_marker_on_a_screen_is_right_or_left_out_with_a_reason(design, pitch):
    """A screen's pixels, of three coloured stripes with dark gaps between them, photographed askew: moire."""
    rng, fine = np.random.default_rng(14), 8
    corners = quad(rng, side=80, tilt=0.3)
    u, v = np.meshgrid(*[(np.arange(SIZE * fine) + 0.5) / fine] * 2)
    x, y = (u * np.cos(0.1) + v * np.sin(0.1)) / pitch, (v * np.cos(0.1) - u * np.sin(0.1)) / pitch
    open_ = (np.mod(y, 1) < 0.85)[..., None] & (
        np.abs(np.mod(x[..., None] - np.array([0.17, 0.5, 0.83]) + 0.5, 1) - 0.5) < 0.14
    )
    screen = open_.reshape(SIZE, fine, SIZE, fine, 3).mean(axis=(1, 3)) / 0.24
    image = np.clip(
        np.rint(picture(corners, NAME, 6, white=150.0)[..., None] * screen + rng.normal(0, 1, screen.shape)), 0, 255
    ).astype(np.uint8)
    found = detect_markers(image, camera(), sheet(design))
    if len(found.marker):
        assert found.marker.tolist() == [6]
        assert np.abs(found.corners[0] - corners).max() < 0.25
    else:
        assert not found.left_out or found.left_out[0][0] == 6
