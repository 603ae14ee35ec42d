"""Quadrangles that may be markers: those of one place together, the largest of them to be read first.

Source: as OpenCV's ArUco reader sorts its candidates, Garrido-Jurado et al., Pattern Recognition 47, 2014
"""

from typing import NamedTuple

import numpy as np

from vision.corners.numba_compilation import kernel, kernel_part

ONE_PLACE = (
    0.125  # of the smaller one's perimeter, that corners of two are apart less than where they are of one marker
)
ANOTHER = 0.21  # of a cell, beyond which one of the same place is read as well where those before it are not a marker
FROM_BORDER = 3  # px; what comes nearer to the image's border may be cut off


class Candidates(NamedTuple):
    """quads : (n, 4, 2) px, clockwise, largest first; tries : (k,) rows of quads, place after place; first : (m + 1,)
    of a place's in tries.
    """

    quads: np.ndarray
    tries: np.ndarray
    first: np.ndarray


def marker_candidates(quads: np.ndarray, shape: tuple[int, int], size: int) -> Candidates:
    """Candidates out of quadrangles (n, 4, 2) px, in an image (height, width), for markers of `size` cells each way,
    their border included.
    """
    sides = np.sqrt(((quads - quads[:, [1, 2, 3, 0]]).astype(np.float32) ** 2).sum(axis=2))
    perimeters = sides.sum(axis=1)
    order = np.argsort(-perimeters, kind="stable")
    places = np.full(len(quads), -1)
    tries, first = np.empty(len(quads), np.int64), np.zeros(len(quads) + 1, np.int64)
    sorted_, perimeters = np.ascontiguousarray(quads[order], np.float64), perimeters[order].astype(np.float64)
    _together(sorted_, perimeters, places)
    count = _in_turn(
        sorted_,
        perimeters,
        places,
        np.array([shape[1], shape[0]]) - 1 - FROM_BORDER,
        ANOTHER / (4 * size),
        tries,
        first,
    )
    return Candidates(sorted_, tries, first[: count + 1])


@kernel_part
def _apart2(a: np.ndarray, b: np.ndarray) -> float:
    """Mean square of how far the corners of two quadrangles (4, 2) are apart, px^2, from whichever corner on they are
    nearest.
    """
    least = np.inf
    for turn in range(4):
        total = 0.0
        for k in range(4):
            dx, dy = a[(k + turn) & 3, 0] - b[k, 0], a[(k + turn) & 3, 1] - b[k, 1]
            total += dx * dx + dy * dy
        least = min(least, 0.25 * total)
    return least


@kernel
def _together(quads: np.ndarray, perimeters: np.ndarray, places: np.ndarray) -> None:
    """Number the places (n,) of quadrangles, largest first; all of them -1 before."""
    count, n = 0, len(quads)
    middles = np.empty((n, 2))
    for i in range(n):
        for axis in range(2):
            middles[i, axis] = 0.25 * (quads[i, 0, axis] + quads[i, 1, axis] + quads[i, 2, axis] + quads[i, 3, axis])
    for i in range(n):
        for j in range(i + 1, n):
            near = (ONE_PLACE * perimeters[j]) ** 2
            dx, dy = middles[i, 0] - middles[j, 0], middles[i, 1] - middles[j, 1]
            if dx * dx + dy * dy >= near or (places[i] >= 0 and places[j] >= 0) or _apart2(quads[i], quads[j]) >= near:
                continue
            if places[i] < 0 and places[j] < 0:
                places[i] = places[j] = count
                count += 1
            else:
                places[i] = places[j] = max(places[i], places[j])
        if places[i] < 0:
            places[i] = count
            count += 1


@kernel
def _in_turn(
    quads: np.ndarray,
    perimeters: np.ndarray,
    places: np.ndarray,
    last: np.ndarray,
    another: float,
    tries: np.ndarray,
    first: np.ndarray,
) -> int:
    """Write Candidates.tries and first; returns how many places there are. last : (2,) x, y px; another : of the
    perimeter; places : overwritten
    """
    count, at, n = 0, 0, len(quads)
    for i in range(n):
        place, own = places[i], i
        if place < 0:
            continue
        inside = True
        for k in range(4):
            for axis in range(2):
                inside = inside and FROM_BORDER <= quads[i, k, axis] <= last[axis]
        for j in range(i, n):
            if places[j] != place:
                continue
            places[j] = -1
            if inside and (j == i or _apart2(quads[j], quads[own]) > (another * perimeters[j]) ** 2):
                tries[at], own = j, j
                at += 1
        if inside:
            count += 1
            first[count] = at
    return count
