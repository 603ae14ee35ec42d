"""Outlines that are quadrangles: a closed line of pixels is taken for a polygon, and kept where that has four corners
and is convex.

Source: Ramer, Computer Graphics and Image Processing 1, 1972; Douglas and Peucker, Cartographica 10, 1973; each from
    two points that are far apart
"""

from typing import NamedTuple

import numpy as np

from vision.corners.numba_compilation import kernel, kernel_part

AWAY = 0.03  # of an outline's pixels, that it may be away from its polygon
SHORTEST = 0.05  # of an outline's pixels, that each side must be long
# corners, from which those on straight sides cannot be dropped down to four: of two next to each other one stays
MOST = 10


class Traced(NamedTuple):
    """An outline's pixels x, y : (k,) int32, in its order, and room for numbers of them, int32: pieces : (MOST + 1, 2)
    and corners : (MOST,).
    """

    x: np.ndarray
    y: np.ndarray
    pieces: np.ndarray
    corners: np.ndarray


def outline_buffers(most: int) -> Traced:
    """Traced of outlines of at most so many pixels."""
    return Traced(
        np.empty(most, np.int32), np.empty(most, np.int32), np.empty((MOST + 1, 2), np.int32), np.empty(MOST, np.int32)
    )


@kernel
def quadrangle_of_outline(traced: Traced, pixels: int, found: np.ndarray, row: int) -> int:
    """1 where the outline of the first `pixels` of Traced is a convex quadrangle, 0 where not; its corners, clockwise,
    into found[row] (4, 2).
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


@kernel_part
def _farthest(x: np.ndarray, y: np.ndarray, pixels: int, start: int) -> tuple[int, int]:
    """(number of the pixel farthest from that at start, px^2 it is away); of several the first after start."""
    far, most = start, 0
    for part in range(2):  # after start, then before it
        low, high = (start + 1, pixels) if part == 0 else (0, start)
        for k in range(low, high):
            dx, dy = x[k] - x[start], y[k] - y[start]
            if dx * dx + dy * dy > most:
                far, most = k, dx * dx + dy * dy
    return far, most


@kernel_part
def _corners(traced: Traced, pixels: int, away2: float) -> int:
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


@kernel_part
def _straightened(traced: Traced, count: int, away2: float) -> int:
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
