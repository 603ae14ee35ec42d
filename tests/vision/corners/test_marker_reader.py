"""Markers found and read in pictures of every kind, of every family; what is seen twice, and what has an outline around
it.
"""

import cv2
import numpy as np
import pytest

from tests.vision.corners.sheet import NAME, sheet
from tests.vision.exact_pictures import quad
from vision.corners.marker_detection_and_corner_fit import read_markers
from vision.marker_corner_prediction import marker_cells

FINE = 12  # texture pixels to a cell
NEAR = 0.9  # share of the markers read, whose corners are so near; others are partly covered
GROUNDS = ("flat", "slope", "cloth", "checks")
FAMILIES = (
    "DICT_4X4_1000",
    NAME,
    "DICT_6X6_250",
    "DICT_7X7_50",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_36h11",
)


def ground(rng, width, height):
    """(height, width) float: what markers lie on."""
    kind = GROUNDS[rng.integers(len(GROUNDS))]
    if kind == "flat":
        return np.full((height, width), rng.uniform(20, 200))
    if kind == "slope":
        return np.add.outer(np.linspace(*rng.uniform(10, 230, 2), height), np.linspace(*rng.uniform(-60, 60, 2), width))
    if kind == "cloth":
        return 100 + rng.uniform(20, 200) * 3 * cv2.GaussianBlur(
            rng.normal(size=(height, width)), (0, 0), rng.uniform(0.5, 8)
        )
    v, u = np.mgrid[:height, :width] // rng.integers(5, 60)
    return np.where((u + v) % 2, *rng.uniform(10, 240, 2))


def lay(image, corners, name, number, margin, white, black):
    """Draw a marker with corners (4, 2) px and so many cells of white around it onto an image, in place."""
    cells = marker_cells(name, number)[1:-1, 1:-1]
    printed = np.pad(np.kron(cells, np.ones((FINE, FINE))), int(margin * FINE), constant_values=1.0).astype(np.float32)
    low, high = int(margin * FINE) - 0.5, len(printed) - int(margin * FINE) - 0.5
    square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    reach = 0.8 * np.ptp(corners, axis=0)
    (x0, y0), (x1, y1) = (
        np.clip(end, 0, image.shape[::-1]).astype(int)
        for end in (corners.min(axis=0) - reach, corners.max(axis=0) + reach + 1)
    )
    if x1 <= x0 or y1 <= y0:
        return
    here = cv2.getPerspectiveTransform(square, (corners - [x0, y0]).astype(np.float32))
    thrice, size = np.array([[3.0, 0, 1], [0, 3, 1], [0, 0, 1]]) @ here, (x1 - x0, y1 - y0)
    paper, grey = (
        cv2.resize(cv2.warpPerspective(part, thrice, (3 * size[0], 3 * size[1])), size, interpolation=cv2.INTER_AREA)
        for part in (np.ones_like(printed), black + (white - black) * printed)
    )
    image[y0:y1, x0:x1] = image[y0:y1, x0:x1] * (1 - paper) + grey


def photograph(rng, name, numbers, width, height):
    """(image (height, width) uint8, {identity: corners (4, 2) px}): markers of 12 px and more, tilted, over each other
    and the border, lit, blurred, crossed, with noise."""
    image, true = ground(rng, width, height).astype(float), {}
    for number in rng.permutation(numbers)[: rng.integers(1, 8)].tolist():
        side = np.exp(rng.uniform(np.log(12), np.log(height / 2.5)))
        corners = quad(rng, side, rng.uniform(0, 1.2), 0) + rng.uniform(-5, [width + 5, height + 5])
        true[number], white = corners, rng.uniform(60, 250)
        lay(image, corners, name, number, rng.choice([0.3, 1, 2]), white, white * rng.uniform(0.02, 0.75))
    for _ in range(rng.integers(4) if rng.random() < 0.3 else 0):
        ends = rng.integers(0, [width, height], (2, 2)).tolist()
        cv2.line(image, *ends, rng.uniform(0, 255), int(rng.integers(1, 6)), cv2.LINE_AA)
    v, u = (np.mgrid[:height, :width] / np.array([height, width])[:, None, None]) - 0.5
    image *= (
        (1 - rng.uniform(0, 1.2) * (u * u + v * v)) * (1 + rng.uniform(-0.6, 0.6) * u) * rng.choice([0.3, 0.7, 1, 1.3])
    )
    image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 2)) + rng.normal(
        0, rng.choice([0.5, 1, 3, 8]), image.shape
    )
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), true


def count_read(design, rng, name, count, width, height):
    """How many markers of a rig are read within 4 px in so many photographs, nearly all of those read."""
    numbers, near = list(range(20)), []
    markers = sheet(design, name, numbers)
    for k in range(count):
        image, true = photograph(rng, name, range(25), width, height)
        read = read_markers(image, markers)
        assert set(read.marker.tolist()) <= true.keys() & set(numbers), (name, k)
        near += [
            bool(np.abs(corners - true[number]).max() < 4)
            for number, corners in zip(read.marker.tolist(), read.corners)
        ]
    assert np.mean(near) > NEAR
    return sum(near)


@pytest.mark.parametrize("name", ["DICT_4X4_50", NAME])
def test_markers_are_read_where_they_are(design, name):
    assert count_read(design, np.random.default_rng(1), name, 40, 320, 240) > 25


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_markers_of_every_family_are_read_where_they_are(design, name):
    rng = np.random.default_rng(2)
    assert sum(count_read(design, rng, name, 60, *size) for size in ((640, 480), (1280, 1024))) > 100


def square(left, top, side):
    """(4, 2) px corners of an upright marker."""
    return np.array([[left, top], [left + side, top], [left + side, top + side], [left, top + side]], float)


def test_a_marker_that_is_there_twice_is_left_out_with_a_reason(design):
    image = np.full((240, 320), 200.0)
    for left, number in ((30, 3), (130, 3), (230, 8)):
        lay(image, square(left, 80, 60), NAME, number, 1, 220, 20)
    read = read_markers(np.clip(np.rint(image), 0, 255).astype(np.uint8), sheet(design, NAME, [3, 8]))
    assert read.marker.tolist() == [8]
    assert [(one.marker, one.repeated, one.reason) for one in read.left_out] == [(3, True, "seen 2 times in one image")]


@pytest.mark.parametrize("turn", range(4))
def test_corners_begin_at_the_markers_own_first(design, turn):
    image, corners = np.full((240, 320), 200.0), np.roll(square(100, 60, 84), -turn, axis=0)
    lay(image, corners, NAME, 8, 1, 220, 20)
    read = read_markers(np.clip(np.rint(image), 0, 255).astype(np.uint8), sheet(design, NAME, [3, 8]))
    assert read.marker.tolist() == [8]
    assert np.abs(read.corners[0] - corners).max() < 2


@pytest.mark.parametrize("margin", [0.7, 0.85, 1.0])
def test_a_marker_whose_white_margin_ends_in_the_dark_is_read(design, margin):
    """The margin's outline is not taken for the marker's own: a cube's face on a dark ground."""
    markers = sheet(design, NAME, [3, 8])
    for side in (40, 60, 80):
        image = np.full((240, 320), 30.0)
        lay(image, square(100, 60, side), NAME, 8, margin, 220, 20)
        image = cv2.GaussianBlur(image, (0, 0), 0.8)
        assert read_markers(np.clip(np.rint(image), 0, 255).astype(np.uint8), markers).marker.tolist() == [8]
