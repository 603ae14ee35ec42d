"""Reader of markers in a whole image: quadrangles, their bits, the identities of a rig's markers.

Source: as OpenCV's ArUco reader tells them, Garrido-Jurado et al., Pattern Recognition 47, 2014; threshold of two
    classes, Otsu 1979
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from rig.arrays import Floats, ImageBytes, Integers, Pixels
from vision.corners.dark_pixel_outlines import LEFT, WINDOWS, mark_dark_pixels, trace_quadrangles
from vision.corners.numba_compilation import inlined_kernel, kernel
from vision.corners.quadrangle_candidates import Candidates, empty_outline_buffers, marker_candidates
from vision.targets import MarkerMap, marker_cells

CELL = 8  # points each way that are looked at in a cell
MARGIN = 1  # of them, next to other cells, that do not count
FAINTEST = 5.0  # grey levels, standard deviation; what varies less is of one colour
# share of a cell's points that are bright, above which it is not black; above as large a share of dark ones it is not
# white
WHITE = 0.49
BORDER = 0.35  # of the number of bits, that cells of the black border may be wrong
CORRECTED = 0.6  # of the errors that a dictionary can correct, that are
_1 = np.uint64(1)


class Codes(NamedTuple):
    """What markers of one dictionary look like. bits : (m, 4) uint64, row by row, for each corner that the reading may
    begin with
    n : bits each way; wrong : errors that are corrected."""

    bits: Integers
    n: int
    wrong: int


@lru_cache
def marker_codes(dictionary_name: str, numbers: tuple[int, ...]) -> Codes:
    """Codes (bits of all four turns) of numbered markers of a dictionary."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary_name))
    n = dictionary.markerSize
    places = (_1 << np.arange(n * n, dtype=np.uint64)).reshape(n, n)
    inner = [marker_cells(dictionary_name, number)[2:-2, 2:-2].astype(bool) for number in numbers]
    bits = np.array([[places[np.rot90(cells, -first)].sum() for first in range(4)] for cells in inner], np.uint64)
    return Codes(bits, n, int(CORRECTED * dictionary.maxCorrectionBits))


def identify_markers(image: Pixels, candidates: Candidates, codes: Codes) -> tuple[Floats, Floats]:
    """Identified markers among Candidates of an image: rows of the Codes (k,), corners (k, 4, 2) px."""
    count = len(candidates.first) - 1
    rows, corners = np.full(count, -1), np.empty((count, 4, 2))
    _identify(image, candidates, codes.bits, codes.n, codes.wrong, rows, corners)
    return rows[rows >= 0], corners[rows >= 0]


@kernel
def _identify(
    image: Pixels, places: Candidates, bits: Integers, n: int, wrong: int, rows: Floats, corners: Floats
) -> None:
    """Write rows (m,), -1 where there is none, and corners (m, 4, 2) of each place. bits, n, wrong : as in Codes"""
    patch = np.empty((CELL * (n + 2), CELL * (n + 2)), np.uint8)
    for m in range(len(rows)):
        for t in range(places.first[m], places.first[m + 1]):
            quad = places.quads[places.tries[t]]
            _from_above(image, quad, patch)
            row, first = _read(patch, bits, n, wrong)
            if row >= 0:
                rows[m] = row
                for k in range(4):
                    corners[m, k] = quad[(k + first) & 3]
                break


@inlined_kernel
def _from_above(image: Pixels, quad: Floats, patch: ImageBytes) -> None:
    """patch (s, s) uint8: the pixels of an image nearest to points all over a quadrangle (4, 2) px, its corners the
    outermost ones; 0 outside.
    """
    height, width = image.shape
    px, py, size = quad[:, 0], quad[:, 1], len(patch)
    sx, sy = px[0] - px[1] + px[2] - px[3], py[0] - py[1] + py[2] - py[3]
    dx1, dx2, dy1, dy2 = px[1] - px[2], px[3] - px[2], py[1] - py[2], py[3] - py[2]
    det = (dx1 * dy2 - dx2 * dy1) * (size - 1)
    p, q = (sx * dy2 - dx2 * sy) / det, (dx1 * sy - sx * dy1) / det
    xu, yu = (px[1] - px[0]) / (size - 1) + p * px[1], (py[1] - py[0]) / (size - 1) + p * py[1]
    xv, yv = (px[3] - px[0]) / (size - 1) + q * px[3], (py[3] - py[0]) / (size - 1) + q * py[3]
    for v in range(size):
        x0, y0, w0 = xv * v + px[0], yv * v + py[0], q * v + 1.0
        for u in range(size):
            w = 1.0 / (p * u + w0)
            i, j = int((xu * u + x0) * w + 0.5), int((yu * u + y0) * w + 0.5)
            patch[v, u] = image[j, i] if 0 <= i < width and 0 <= j < height else 0


@inlined_kernel
def _between_classes(patch: ImageBytes) -> int:
    """Grey level above which points of a patch (s, s) are bright, or -1 where they vary less than FAINTEST away from
    its rim.
    """
    size, rim = len(patch), CELL // 2
    histogram = np.zeros(256, np.int64)
    count, total, square = 0, 0.0, 0.0
    for v in range(size):
        for u in range(size):
            histogram[patch[v, u]] += 1
            if rim <= u < size - rim and rim <= v < size - rim:
                grey = float(patch[v, u])
                count, total, square = count + 1, total + grey, square + grey * grey
    if square * count - total * total < (FAINTEST * count) ** 2:
        return -1
    every, whole = size * size, 0.0
    for k in range(256):
        whole += k * histogram[k]
    dark, part, level, most = 0, 0.0, -1, 0.0
    for k in range(256):
        dark, part = dark + histogram[k], part + k * histogram[k]
        if 0 < dark < every:
            apart = dark * (every - dark) * (part / dark - (whole - part) / (every - dark)) ** 2
            if apart > most:
                level, most = k, apart
    return level


@inlined_kernel
def _read(patch: ImageBytes, bits: Integers, n: int, wrong: int) -> tuple[int, int]:
    """(row of the bits that a patch shows or -1, the corner that is the marker's own first)."""
    level, size = _between_classes(patch), n + 2
    if level < 0:
        return -1, 0
    least, most = int(math.floor(WHITE * (CELL - 2 * MARGIN) ** 2)), (CELL - 2 * MARGIN) ** 2
    white, black, off = np.uint64(0), np.uint64(0), 0  # bits that are not black, that are not white
    for j in range(size):
        for i in range(size):
            bright = 0
            for v in range(CELL * j + MARGIN, CELL * (j + 1) - MARGIN):
                for u in range(CELL * i + MARGIN, CELL * (i + 1) - MARGIN):
                    bright += patch[v, u] > level
            if 0 < i <= n and 0 < j <= n:
                at = np.uint64((j - 1) * n + i - 1)
                white |= np.uint64(bright > least) << at
                black |= np.uint64(most - bright > least) << at
            else:
                off += bright > least
    if off > int(BORDER * n * n):
        return -1, 0
    for row in range(len(bits)):
        best, first = wrong + 1, 0
        for turn in range(4):
            errors, left = 0, (bits[row, turn] & black) | (~bits[row, turn] & white)
            while left != 0 and errors < best:
                left &= left - _1
                errors += 1
            if errors < best:
                best, first = errors, turn
        if best <= wrong:
            return row, first
    return -1, 0


SHORTEST, LONGEST = 0.03, 4.0  # of the image's longer side, that a marker's outline has pixels
WORD = 8  # pixels that are looked at together
ROOM = 1024  # quadrangles, to begin with


class ExcludedMarker(NamedTuple):
    """A marker that was read and not placed. marker : identity; reason : in words; repeated : whether it is that one
    image shows it twice.
    """

    marker: int
    reason: str
    repeated: bool = False


class ReadMarkers(NamedTuple):
    """Markers whose corners are known to a pixel or so: as a reader saw them, or where they are expected.

    marker : (m,) identities; corners : (m, 4, 2) px; left_out : those that are not to be placed
    """

    marker: Integers
    corners: Floats
    left_out: Sequence[ExcludedMarker] = ()


def read_markers(image: Pixels, marker_map: MarkerMap) -> ReadMarkers:
    """Read the markers of a rig in a whole image (height, width) uint8; repeated ones are excluded."""
    image = np.require(image, np.uint8, ["C", "W"])  # kernels are compiled for one kind of array
    found: dict[int, list[Floats]] = {}
    left_out, all_ = [], find_dark_quadrangles(image)
    for name in dict.fromkeys(marker_map.dictionary):
        own = tuple(number for number, other in zip(marker_map.id.tolist(), marker_map.dictionary) if other == name)
        wanted = marker_codes(name, own)
        for row, quad in zip(*identify_markers(image, marker_candidates(all_, image.shape, wanted.n + 2), wanted)):
            found.setdefault(own[row], []).append(quad)
    for number in [number for number, quads in found.items() if len(quads) > 1]:
        left_out.append(ExcludedMarker(number, f"seen {len(found.pop(number))} times in one image", True))
    numbers = sorted(found)
    return ReadMarkers(
        np.array(numbers, int), np.array([found[k][0] for k in numbers], float).reshape(-1, 4, 2), left_out
    )


def find_dark_quadrangles(image: Pixels) -> Floats:
    """(n, 4, 2) px, int32, clockwise: quadrangles around dark regions of an image, and around holes in them."""
    height, width = image.shape
    longer = max(height, width)
    words = np.zeros((height + 2 * LEFT, -(-(width + 2 * LEFT) // WORD)), np.uint64)
    marks, traced, parts = words.view(np.uint8), empty_outline_buffers(int(LONGEST * longer)), []
    found = np.empty((ROOM, 4, 2), np.int32)
    for window in WINDOWS:
        mark_dark_pixels(image, window, marks)
        count = trace_quadrangles(words, marks, int(SHORTEST * longer), traced, found)
        if count > len(found):
            found = np.empty((count, 4, 2), np.int32)
            mark_dark_pixels(image, window, marks)
            trace_quadrangles(words, marks, int(SHORTEST * longer), traced, found)
        parts.append(found[:count][::-1].copy())
    return np.concatenate(parts)
