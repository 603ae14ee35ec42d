"""Quadrangles of traced outlines, and their selection as candidates for markers.

Source: Ramer, Computer Graphics and Image Processing 1, 1972; Douglas and Peucker, Cartographica 10, 1973; each from
    two points that are far apart

Source: as OpenCV's ArUco reader sorts its candidates, Garrido-Jurado et al., Pattern Recognition 47, 2014
"""

from typing import NamedTuple

import numpy as np

from rig.arrays import Floats, Integers
from vision.corners.numba_compilation import inlined_kernel, kernel

AWAY = 0.03  # of an outline's pixels, that it may be away from its polygon
SHORTEST = 0.05  # of an outline's pixels, that each side must be long
# corners, from which those on straight sides cannot be dropped down to four: of two next to each other one stays
MOST = 10


class OutlineBuffers(NamedTuple):
    """An outline's pixels x, y : (k,) int32, in its order, and room for numbers of them, int32: pieces : (MOST + 1, 2)
    and corners : (MOST,).
    """

    x: Floats
    y: Floats
    pieces: Floats
    corners: Floats


def empty_outline_buffers(most_pixels: int) -> OutlineBuffers:
    """Empty buffers (Traced) for outlines of at most so many pixels."""
    return OutlineBuffers(
        np.empty(most_pixels, np.int32),
        np.empty(most_pixels, np.int32),
        np.empty((MOST + 1, 2), np.int32),
        np.empty(MOST, np.int32),
    )


@kernel
def write_outline_quadrangle(traced: OutlineBuffers, pixels: int, found: Integers, row: int) -> int:
    """Write the corners of a traced outline to found[row] if it is a convex quadrangle; returns 1 or 0.

    found : (k, 8) px
    """
    x, y, corners = traced.x, traced.y, traced.corners
    away = AWAY * pixels
    count = _straightened(traced, _corners(traced, pixels, away * away), away * away)
    if count != 4:
        return 0
    shortest, turn = SHORTEST * pixels, 0
    for k in range(4):
        a, b, c = corners[k], corners[(k + 1) & 3], corners[(k + 2) & 3]
        ux, uy, vx, vy = x[b] - x[a], y[b] - y[a], x[c] - x[b], y[c] - y[b]
        cross = ux * vy - uy * vx
        if cross == 0 or turn * cross < 0 or ux * ux + uy * uy < shortest * shortest:
            return 0
        turn = 1 if cross > 0 else -1
    if row < len(found):
        for k in range(4):
            at = corners[k] if turn > 0 else corners[(4 - k) & 3]
            found[row, k, 0], found[row, k, 1] = x[at], y[at]
    return 1


@inlined_kernel
def _farthest(x: Floats, y: Floats, pixels: int, start: int) -> tuple[int, int]:
    """(number of the pixel farthest from that at start, px^2 it is away); of several the first after start."""
    far, most = start, 0
    for part in range(2):  # after start, then before it
        low, high = (start + 1, pixels) if part == 0 else (0, start)
        for k in range(low, high):
            dx, dy = x[k] - x[start], y[k] - y[start]
            if dx * dx + dy * dy > most:
                far, most = k, dx * dx + dy * dy
    return far, most


@inlined_kernel
def _corners(traced: OutlineBuffers, pixels: int, away2: float) -> int:
    """Number of corners of the polygon that a closed line of so many pixels is within away2 (px^2) of; MOST and more
    are not told apart.
    """
    x, y, pieces, corners = traced.x, traced.y, traced.pieces, traced.corners
    start, far, most = 0, 0, 0
    for _ in range(3):
        start = far
        far, most = _farthest(x, y, pixels, start)
    if most <= away2:
        return 1
    count, waiting = 0, 2
    pieces[0, 0], pieces[0, 1], pieces[1, 0], pieces[1, 1] = far, start, start, far
    while waiting > 0:
        waiting -= 1
        a, b = pieces[waiting, 0], pieces[waiting, 1]
        dx, dy = float(x[b] - x[a]), float(y[b] - y[a])
        length2, worst, at = dx * dx + dy * dy, 0.0, a
        for part in range(2):  # a piece may go on from the line's end to its beginning
            low, high = (a + 1, b if a < b else pixels) if part == 0 else (0, 0 if a < b else b)
            for k in range(low, high):
                u, v = float(x[k] - x[a]), float(y[k] - y[a])
                along = u * dx + v * dy
                if along < 0:
                    off = (u * u + v * v) * length2
                elif along > length2:
                    off = ((u - dx) * (u - dx) + (v - dy) * (v - dy)) * length2
                else:
                    off = (v * dx - u * dy) ** 2
                if off > worst:
                    worst, at = off, k
        if worst <= away2 * length2:
            corners[count] = a
            count += 1
        else:
            pieces[waiting, 0], pieces[waiting, 1], pieces[waiting + 1, 0], pieces[waiting + 1, 1] = at, b, a, at
            waiting += 2
            if count + waiting >= MOST:  # each that waits has a corner at least
                return MOST
    return count


@inlined_kernel
def _straightened(traced: OutlineBuffers, count: int, away2: float) -> int:
    """Number of corners that stay, of `count`, where one between two others on nearly one line is dropped, and the next
    is not looked at.
    """
    x, y, corners = traced.x, traced.y, traced.corners
    if count >= MOST or count < 3:
        return count
    total, start, at, read, write, k = count, corners[count - 1], corners[0], 1, 0, 0
    while k < total and count > 2:
        end = corners[read % total]
        read += 1
        ux, uy, vx, vy = x[at] - x[start], y[at] - y[start], x[end] - x[at], y[end] - y[at]
        dx, dy = float(ux + vx), float(uy + vy)
        off = ux * dy - uy * dx
        if off * off <= 0.5 * away2 * (dx * dx + dy * dy) and dx != 0 and dy != 0 and ux * vx + uy * vy >= 0:
            count -= 1
            start, at = end, corners[read % total]
            read += 1
            k += 1
        else:
            start, at = at, end
        corners[write] = start
        write += 1
        k += 1
    return count


ONE_PLACE = (
    0.125  # of the smaller one's perimeter, that corners of two are apart less than where they are of one marker
)
ANOTHER = 0.21  # of a cell, beyond which one of the same place is read as well where those before it are not a marker
FROM_BORDER = 3  # px; what comes nearer to the image's border may be cut off


class Candidates(NamedTuple):
    """quads : (n, 4, 2) px, clockwise, largest first; tries : (k,) rows of quads, place after place; first : (m + 1,)
    of a place's in tries.
    """

    quads: Floats
    tries: Integers
    first: Integers


def marker_candidates(quads: Floats, shape: tuple[int, int], size: int) -> Candidates:
    """Candidates for markers of `size` cells each way, selected from quadrangles (n, 4, 2) px of an image."""
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


@inlined_kernel
def _apart2(a: Floats, b: Floats) -> float:
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
def _together(quads: Floats, perimeters: Floats, places: Floats) -> None:
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
    quads: Floats, perimeters: Floats, places: Floats, last: Floats, another: float, tries: Integers, first: Integers
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
