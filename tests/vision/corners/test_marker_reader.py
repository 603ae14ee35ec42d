"""Markers found and read: whatever OpenCV's own reader finds, at the same pixels, in pictures of every kind; and each
step by itself.
"""

import cv2
import numpy as np
import pytest

from tests.vision.corners.sheet import NAME, sheet
from tests.vision.pictures import quad
from vision.corners.dark_pixel_outlines import BY, WINDOWS, mark_dark_pixels
from vision.corners.marker_reader import find_dark_quadrangles, identify_markers, marker_codes, read_markers
from vision.corners.quadrangle_candidates import Candidates, marker_candidates
from vision.targets import marker_cells

FINE = 12  # texture pixels to a cell
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


def by_opencv(image, name, numbers):
    """{identity: corners (4, 2) px} that OpenCV's reader, with settings as ours, sees once."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    parameters = cv2.aruco.DetectorParameters()
    parameters.perspectiveRemovePixelPerCell = 8
    only = cv2.aruco.Dictionary(
        dictionary.bytesList[list(numbers)], dictionary.markerSize, dictionary.maxCorrectionBits
    )
    corners, rows, _ = cv2.aruco.ArucoDetector(only, parameters).detectMarkers(image)
    rows = [] if rows is None else rows.ravel().tolist()
    return {numbers[row]: corners[k][0] for k, row in enumerate(rows) if rows.count(row) == 1}


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


def compared(design, rng, name, count, width, height):
    """How many markers OpenCV finds in so many photographs, each of which is read at the same pixels; what is read
    besides is there too.
    """
    numbers, seen = list(range(20)), 0
    markers = sheet(design, name, numbers)
    for k in range(count):
        image, true = photograph(rng, name, range(25), width, height)
        theirs, ours = by_opencv(image, name, numbers), read_markers(image, markers)
        found = dict(zip(ours.marker.tolist(), ours.corners))
        for number, corners in theirs.items():
            assert number in found, (name, k, number)
            np.testing.assert_array_equal(found[number], corners)
        for number in found.keys() - theirs.keys():
            assert np.abs(found[number] - true[number]).max() < 4, (name, k, number)
        seen += len(theirs)
    return seen


@pytest.mark.parametrize("name", ["DICT_4X4_50", NAME])
def test_what_opencv_reads_is_read_at_the_same_pixels(design, name):
    assert compared(design, np.random.default_rng(1), name, 40, 320, 240) > 25


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_what_opencv_reads_is_read_at_the_same_pixels_in_every_family(design, name):
    rng = np.random.default_rng(2)
    assert sum(compared(design, rng, name, 60, *size) for size in ((640, 480), (1280, 1024))) > 100


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (61, 1), (50, 70)])
def test_what_is_darker_than_its_surroundings_is_marked(window, shape):
    image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    out, r = np.zeros((shape[0] + 2, shape[1] + 2), np.uint8), window // 2
    mark_dark_pixels(image, window, out)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(image, r, mode="edge").astype(int), (window, window))
    np.testing.assert_array_equal(out[1:-1, 1:-1], np.rint(around.mean(axis=(2, 3))) - image >= BY)
    assert not out[[0, -1]].any() and not out[:, [0, -1]].any()


def test_outlines_of_what_is_dark_and_of_what_is_bright_in_it_are_found():
    """A dark frame: the outer pixels of the dark are the one outline, those of the dark around the bright the other; a
    disc has none.
    """
    image = np.full((200, 200), 200, np.uint8)
    image[40:101, 30:111] = 20
    image[60:81, 60:81] = 200
    cv2.circle(image, (150, 150), 30, 20, -1)
    found = find_dark_quadrangles(image)
    assert {tuple(q.min(axis=0)) + tuple(q.max(axis=0)) for q in found} >= {(30, 40, 110, 100), (59, 59, 81, 81)}
    assert found[..., 1].max() < 120  # the disc is none


def test_outlines_of_three_hundredths_of_the_longer_side_are_the_shortest():
    image = np.full((200, 1000), 200, np.uint8)
    image[50:58, 100:108] = image[50:59, 300:309] = 20  # 28 and 32 pixels around
    assert {tuple(q.min(axis=0)) + tuple(q.max(axis=0)) for q in find_dark_quadrangles(image)} == {(300, 50, 308, 58)}


@pytest.mark.parametrize("turn", range(4))
def test_a_code_is_told_however_it_lies_and_with_as_many_errors_as_are_corrected(turn):
    wanted = marker_codes(NAME, (3, 8))
    cells = marker_cells(NAME, 8)[1:-1, 1:-1]
    quads = Candidates(np.array([[[20, 20], [103, 20], [103, 103], [20, 103]]], float), np.array([0]), np.array([0, 1]))
    first = np.roll(quads.quads[0], -turn, axis=0)[0]
    for errors in range(wanted.wrong + 2):
        shown = cells.copy()
        shown[1, 1 : 1 + errors] = 1 - shown[1, 1 : 1 + errors]
        image = np.full((124, 124), 200, np.uint8)
        image[20:104, 20:104] = np.kron(20 + 180 * np.rot90(shown, -turn), np.ones((12, 12)))
        rows, corners = identify_markers(image, quads, wanted)
        assert rows.tolist() == ([1] if errors <= wanted.wrong else [])
        if len(rows):
            np.testing.assert_array_equal(corners[0, 0], first)


def test_of_one_place_the_largest_is_read_first_and_what_the_border_may_cut_off_is_not():
    at = np.array([[0, 0], [70, 0], [70, 70], [0, 70]])
    inset = 35 + (at - 35) * 50 // 70
    quads = np.array([inset + 50, at + 50, at + [200, 50], at + [1, 200], at + [50, 51]], np.int32)
    first, tries, starts = marker_candidates(quads, (300, 400), 7)
    np.testing.assert_array_equal(first[tries[:2]], quads[[1, 0]])  # the fifth is the second's, a pixel off
    assert starts.tolist() == [0, 2, 3] and (first[tries[2]] == quads[2]).all()
