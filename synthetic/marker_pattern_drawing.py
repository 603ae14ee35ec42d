"""Drawing of a marker's printed pattern into an image.

The exact share of white in each pixel.

An element's square is carried to the marker's cells by the lens and the homography; over one element both are as good
as affine, so what it sees there is a parallelogram, and what part of that lies on white cells is an area. Where one
line between cells crosses it the area has a closed form, elsewhere polygons are clipped (Sutherland and Hodgman,
Communications of the ACM 17, 1974). No texture and no sampling: an edge lies where geometry puts it, whatever the grid.
"""

import math
from typing import NamedTuple

import numpy as np

from rig.compute.numba_kernels_and_lazy_exports import njit


class Footprint(NamedTuple):
    """What an element of the picture sees, in cells: the parallelogram about (X, Y) with the sides (Xu, Yu) and (Xv,
    Yv).
    """

    X: float
    Y: float
    Xu: float
    Xv: float
    Yu: float
    Yv: float


@njit(cache=True, nogil=True)
def bilinear_value(image, x, y, channel) -> float:
    """Bilinear value of a channel of an image (h, w, channels) at (x, y)."""
    x0, y0 = int(x), int(y)
    fx, fy = x - x0, y - y0
    top = image[y0, x0, channel] + fx * (np.float32(image[y0, x0 + 1, channel]) - image[y0, x0, channel])
    bottom = image[y0 + 1, x0, channel] + fx * (np.float32(image[y0 + 1, x0 + 1, channel]) - image[y0 + 1, x0, channel])
    return top + fy * (bottom - top)


@njit(cache=True, nogil=True)
def draw_marker_pattern(image, places, box, ideal, H, cells, number, out) -> None:
    """Draw a marker's pattern into an image whose pixels show its white paper.

    image : (h, w, 3) uint8 pinhole picture: grey with white paper, grey with black paper, number of the marker's part
    places : (k, l, 2) where in it each element of the finer picture looks; box : x0, y0, x1, y1 of the elements about
        the marker
    ideal : (2, y1 - y0 + 2, x1 - x0 + 2) x / z, y / z of the box's elements, widened by one on every side
    H : (3, 3) ideal coordinates to cells; cells : (n, n) 1 white, 0 black; number : of the part
    out : (k, l) float32 grey 0..255 of the finer picture, changed in place
    """
    work = np.empty((4, 12, 2))
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x0, x1):
            px, py = places[y, x, 0], places[y, x, 1]
            if image[int(py + 0.5), int(px + 0.5), 2] != number:
                continue
            j, i = y - y0 + 1, x - x0 + 1
            a, b = ideal[0, j, i], ideal[1, j, i]
            au, av = 0.5 * (ideal[0, j, i + 1] - ideal[0, j, i - 1]), 0.5 * (ideal[0, j + 1, i] - ideal[0, j - 1, i])
            bu, bv = 0.5 * (ideal[1, j, i + 1] - ideal[1, j, i - 1]), 0.5 * (ideal[1, j + 1, i] - ideal[1, j - 1, i])
            w = 1.0 / (H[2, 0] * a + H[2, 1] * b + H[2, 2])
            X, Y = (H[0, 0] * a + H[0, 1] * b + H[0, 2]) * w, (H[1, 0] * a + H[1, 1] * b + H[1, 2]) * w
            Xa, Xb, Ya, Yb = (
                (H[0, 0] - X * H[2, 0]) * w,
                (H[0, 1] - X * H[2, 1]) * w,
                (H[1, 0] - Y * H[2, 0]) * w,
                (H[1, 1] - Y * H[2, 1]) * w,
            )
            seen = Footprint(X, Y, Xa * au + Xb * bu, Xa * av + Xb * bv, Ya * au + Yb * bu, Ya * av + Yb * bv)
            share = white_share(cells, seen, work)
            if share < 1:
                black = bilinear_value(image, px, py, 1)
                out[y, x] = black + share * (out[y, x] - black)


@njit(cache=True, nogil=True)
def white_share(cells, footprint, work) -> float:
    """Share of white (0..1) of a pattern's cells in a pixel's Footprint.

    cells : (n, n) 1 white, 0 black, cell (0, 0) from 0 to 1 along both; white beyond; work : (4, 12, 2), overwritten
    """
    n = cells.shape[0]
    half_x, half_y = 0.5 * (abs(footprint.Xu) + abs(footprint.Xv)), 0.5 * (abs(footprint.Yu) + abs(footprint.Yv))
    i0, i1 = max(int(math.floor(footprint.X - half_x)), -1), min(int(math.floor(footprint.X + half_x)), n)
    j0, j1 = max(int(math.floor(footprint.Y - half_y)), -1), min(int(math.floor(footprint.Y + half_y)), n)
    if i0 > n - 1 or j0 > n - 1 or i1 < 0 or j1 < 0:
        return 1.0
    rows_alike, columns_alike = True, True
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            here = _white(cells, i, j)
            rows_alike &= here == _white(cells, i, j0)
            columns_alike &= here == _white(cells, i0, j)
    if rows_alike and columns_alike:
        return _white(cells, i0, j0)
    if rows_alike and i1 == i0 + 1:
        beyond = _beyond(footprint.X - i1, abs(footprint.Xu), abs(footprint.Xv))
        return _white(cells, i0, j0) + beyond * (_white(cells, i1, j0) - _white(cells, i0, j0))
    if columns_alike and j1 == j0 + 1:
        beyond = _beyond(footprint.Y - j1, abs(footprint.Yu), abs(footprint.Yv))
        return _white(cells, i0, j0) + beyond * (_white(cells, i0, j1) - _white(cells, i0, j0))
    return 1.0 - _black_area(cells, footprint, (i0, j0, i1, j1), work)


@njit(cache=True, nogil=True)
def _white(cells, i, j) -> float:
    n = cells.shape[0]
    return cells[j, i] if 0 <= i < n and 0 <= j < n else 1.0


@njit(cache=True, nogil=True)
def _beyond(distance, a, b) -> float:
    """Share of a parallelogram beyond a line: what a sum of two uniform variables of widths a, b about `distance` has
    above zero.
    """
    wide, narrow = max(a, b), min(a, b)
    at = abs(distance)
    if at >= 0.5 * (wide + narrow):
        share = 1.0
    elif at <= 0.5 * (wide - narrow):
        share = 0.5 + at / wide
    else:
        share = 1.0 - (0.5 * (wide + narrow) - at) ** 2 / (2 * wide * narrow)
    return share if distance > 0 else 1.0 - share


@njit(cache=True, nogil=True)
def _black_area(cells, seen, span, work) -> float:
    """Share of black in a Footprint, cell by cell of span i0, j0, i1, j1."""
    n, square, row, cell, part = cells.shape[0], work[0], work[1], work[2], work[3]
    for c in range(4):
        u, v = -0.5 if c == 0 or c == 3 else 0.5, -0.5 if c < 2 else 0.5
        square[c, 0], square[c, 1] = seen.X + u * seen.Xu + v * seen.Xv, seen.Y + u * seen.Yu + v * seen.Yv
    i0, j0, i1, j1 = span
    dark = 0.0
    for j in range(max(j0, 0), min(j1, n - 1) + 1):
        size = _clipped(square, 4, 1, float(j), 1.0, part)
        size = _clipped(part, size, 1, float(j + 1), -1.0, row)
        for i in range(max(i0, 0), min(i1, n - 1) + 1):
            if size > 2 and cells[j, i] < 0.5:
                left = _clipped(row, size, 0, float(i), 1.0, part)
                left = _clipped(part, left, 0, float(i + 1), -1.0, cell)
                dark += _area(cell, left)
    return dark / _area(square, 4)


@njit(cache=True, nogil=True)
def _clipped(points, count, axis, limit, sign, out) -> int:
    """Part of a convex polygon points (count, 2) whose coordinate `axis` is above a limit (sign 1) or below (-1), in
    out; its count.
    """
    kept = 0
    for k in range(count):
        a, b = points[k], points[(k + 1) % count]
        da, db = sign * (a[axis] - limit), sign * (b[axis] - limit)
        if da >= 0:
            out[kept, 0], out[kept, 1] = a[0], a[1]
            kept += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            t = da / (da - db)
            out[kept, 0], out[kept, 1] = a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def _area(points, count) -> float:
    total = 0.0
    for k in range(1, count - 1):
        a, b = points[k] - points[0], points[k + 1] - points[0]
        total += a[0] * b[1] - b[0] * a[1]
    return abs(total) / 2
