"""Collection of the pixels near the edges of a square, for its fit.

By kind of edge: upright, level, where two meet.
"""

import math
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats, Integers, Singles
from vision.corners.blurred_edge_image_model_and_numba_kernels import inlined_kernel, kernel
from vision.corners.local_lens_and_fit_start import polynomial_along_row

# edge widths on either side of an edge that are looked at; with vision/corners/edge_spread_function.py's KNOTS by
# the rule in tests/bench/edge_fit_width.py:
REACH = 3.6
# of reaches 2.4, 2.8, 3.2, 3.6 and 5, 7, 9, 11 knots the smallest within 1 % of the least corner error on exact and
# rendered pictures
CLEAR = 3.2  # edge widths kept clear of whatever lies beyond the white margin
UPRIGHT, LEVEL, MEETING, SEVERAL = range(
    4
)  # one edge X = i; one edge Y = j; one of each, which meet; any number around cell i, j
KINDS = 4
MOST = 16  # cells to a side of a marker and its white ring, at most: outlooks are tables of so many rows
VIEWS = 17  # of a cell: by which of its four sides are in reach, and where cells beyond the next are
NOWHERE = MOST * MOST * VIEWS  # the entry of an outlook for pixels out of reach
NONE, MANY, MEETS = 0, 1, 10  # codes of an outlook, see there


class EdgePixels(NamedTuple):
    """Pixels near a marker's edges, room for k of them, kind after kind.

    x, y : (k,) float32, local ideal coordinates; greys : (k,) float32, 255ths of white
    i, j : (k,) int32, the edge X = i, the edge Y = j, or the cell; looks : (k,) int32, UPRIGHT: white on the right (1)
    or left (-1); LEVEL: white below (1) or above (-1); MEETING: 1, 2, 4, 8 for white at the top left, top right, bottom
    left, bottom right
    first : (KINDS + 1,) int64, the first pixel of each kind, and how many there are
    """

    x: Singles
    y: Singles
    greys: Singles
    i: Floats
    j: Floats
    looks: Floats
    first: Floats


class Raster(NamedTuple):
    """Room for the pixels of one image row after the other.

    rows : (4, width) float32, local column, ideal coordinates, entry of the outlook; retained : (width,) int32 columns
    x, y, greys : (k,) float32 and entries : (k,) int32 of all pixels that are near an edge, in the image's order
    """

    rows: Floats
    retained: Floats
    x: Singles
    y: Singles
    greys: Singles
    entries: Floats


class Printed(NamedTuple):
    """One marker in an image: what is printed, and where it is looked for.

    cells : (n + 4, n + 4), 1 white, 0 black, the n x n bits with their black border and a ring of white;
        outlook : int8, `pixel_edge_kinds` of them
    n : bits each way; margin : cells of white around it; directions : (2,) rows of the spread's tables for its X and
        its Y edges
    box : (4,) x0 y0 x1 y1 px, the part of the image cut out; lens : (2, TERMS) polynomials from local pixel to local
        ideal coordinates
    centre : (3,) x, y, scale px, of local coordinates
    """

    cells: Floats
    outlook: Floats
    n: int
    margin: float
    directions: Floats
    box: Floats
    lens: Floats
    centre: Floats


def pixel_edge_kinds(cells: Floats) -> Floats:
    """Kind of edge (NOWHERE + 1,) int8 that pixels of each cell see, by cells (k, k) of a marker.

    NONE, MANY edges, one: 2 + 4 where it lies across (Y) + 2 where it is the right or lower side + 1 where white comes
    first, or two that meet:
    MEETS + 16 where that is right + 32 where it is below + the cells around, as EdgePixels.looks has them
    Raises ValueError for more than MOST cells to a side.
    """
    k = len(cells)
    if k > MOST:
        raise ValueError(f"expected a marker of at most {MOST} cells to a side, its white ring included, got {k}")
    at = np.arange(k)
    out = np.zeros((MOST, MOST, VIEWS), np.int8)
    out[..., 16] = MANY  # nobody has looked
    for sides in range(16):
        x = [np.maximum(at - (sides & 1 > 0), 0), at, np.minimum(at + (sides & 2 > 0), k - 1)]
        y = [np.maximum(at - (sides & 4 > 0), 0), at, np.minimum(at + (sides & 8 > 0), k - 1)]
        seen = np.array([[cells[np.ix_(v, u)] for u in x] for v in y])  # (3, 3, k, k)
        rows_alike, columns_alike = (seen == seen[1:2]).all(axis=(0, 1)), (seen == seen[:, 1:2]).all(axis=(0, 1))
        left, right = ((seen[:, u] != seen[:, 1]).any(axis=0) for u in (0, 2))
        top, bottom = ((seen[v] != seen[1]).any(axis=0) for v in (0, 2))
        around = sum(
            2**b * np.where(bottom, *(np.where(right, seen[v, 1 + u], seen[v, u]) for v in (1 + b // 2, b // 2)))
            for b, u in enumerate((0, 1, 0, 1))
        )
        code = np.where((left != right) & (top != bottom), MEETS + 16 * right + 32 * bottom + around, MANY)
        for axis, alike, low, high in (
            (0, rows_alike, seen[1, 0], seen[1, 2]),
            (1, columns_alike, seen[0, 1], seen[2, 1]),
        ):
            one = alike & ((low == cells) != (high == cells))
            far = low == cells
            code = np.where(one, 2 + 4 * axis + 2 * far + (far == (cells == 1)), code)
        out[:k, :k, sides] = np.where(rows_alike & columns_alike, NONE, code)
    return np.append(out.ravel(), np.int8(NONE))


def _outlook_code_table() -> Integers:
    """(MEETS + 64, 4) int32 of the codes of outlooks: the kind, what to add to the cell for i and j, and looks."""
    out = np.zeros((MEETS + 64, 4), np.int32)
    out[[NONE, MANY]] = SEVERAL, 0, 0, 0
    for code in range(2, MEETS):
        axis, far, white_first = (code - 2) >> 2, (code - 2) >> 1 & 1, code & 1
        out[code] = axis, far * (axis == 0), far * (axis == 1), -1 if white_first else 1
    for code in range(64):
        out[MEETS + code] = MEETING, code >> 4 & 1, code >> 5, code & 15
    return out


_OUTLOOKS = _outlook_code_table()
_0, _1, _2, _4, _8, _16 = (np.float32(k) for k in (0, 1, 2, 4, 8, 16))  # numbers that keep kernels in single precision
_MOST, _VIEWS, _NOWHERE, _CLEAR = np.float32(MOST), np.float32(VIEWS), np.float32(NOWHERE), np.float32(CLEAR / REACH)


@inlined_kernel
def _row(quad: Floats, pad: float, y: int, low: int, high: int) -> tuple[int, int]:
    """Pixels [low, high) of image row y that lie in a convex quad (4, 2) px widened by pad."""
    first, last = low - 1.0, high + 1.0
    for k in range(4):
        ex, ey = quad[(k + 1) % 4, 0] - quad[k, 0], quad[(k + 1) % 4, 1] - quad[k, 1]
        room = pad * math.sqrt(ex * ex + ey * ey) + ey * quad[k, 0] - ex * (quad[k, 1] - y)  # ey x <= room inside
        if ey > 1e-9:
            last = min(last, room / ey)
        elif ey < -1e-9:
            first = max(first, room / ey)
        elif room < 0:
            return 0, 0
    return max(low, int(math.ceil(first))), min(high, int(math.floor(last)) + 1)


@kernel
def collect_edge_pixels(
    crop: Floats,
    marker: Printed,
    quad: Floats,
    homography: Floats,
    edge_width: float,
    raster: Raster,
    pixels: EdgePixels,
) -> int:
    """Collect the pixels near an edge into EdgePixels.

    crop : (rows, columns), 255ths of white, of marker.box; marker : Printed; quad : (4, 2) px, the corners
    homography : (3, 3) from local ideal coordinates to cells; edge_width : px; raster : overwritten
    Returns how many
    """
    cx, cy, scale = marker.centre
    box, lens, seen, n = marker.box, marker.lens, marker.outlook, marker.n
    rows, retained = raster.rows, raster.retained
    columns, x, y, entries = rows[0], rows[1], rows[2], rows[3]
    for k in range(box[2] - box[0]):
        columns[k] = (box[0] + k - cx) / scale
    # cells to the pixel in the middle of the marker; perspective changes them with w, and w is followed
    Xx, Xy = homography[0, 0] - 0.5 * n * homography[2, 0], homography[0, 1] - 0.5 * n * homography[2, 1]
    Yx, Yy = homography[1, 0] - 0.5 * n * homography[2, 0], homography[1, 1] - 0.5 * n * homography[2, 1]
    reach_x = (
        REACH
        * edge_width
        * math.sqrt((Xx * lens[0, 1] + Xy * lens[1, 1]) ** 2 + (Xx * lens[0, 2] + Xy * lens[1, 2]) ** 2)
        / scale
    )
    reach_y = (
        REACH
        * edge_width
        * math.sqrt((Yx * lens[0, 1] + Yy * lens[1, 1]) ** 2 + (Yx * lens[0, 2] + Yy * lens[1, 2]) ** 2)
        / scale
    )
    pad = REACH * edge_width + 1 + 0.02 * scale  # a lens bends the sides
    count = np.uintp(0)
    for v in range(box[1], box[3]):
        start, end = _row(quad, pad, v, box[0], box[2])
        if start >= end:
            continue
        _look(rows, (start - box[0], end - box[0]), marker, (v - cy) / scale, homography, (reach_x, reach_y))
        line, found = crop[v - box[1]], np.uintp(0)
        for k in range(np.uintp(start - box[0]), np.uintp(end - box[0])):
            retained[found] = k
            found = found + np.uintp(
                seen[np.uint32(entries[k])] != NONE
            )  # written first and kept after: a processor cannot guess which pixels are
        for m in range(found):
            c = np.uintp(retained[m])
            raster.x[count], raster.y[count], raster.greys[count], raster.entries[count] = (
                x[c],
                y[c],
                line[c],
                np.int32(entries[c]),
            )
            count += np.uintp(1)
    return _sort(raster, int(count), seen, pixels)


@inlined_kernel
def _look(
    rows: Floats, span: tuple[int, int], marker: Printed, v: float, g: Floats, reach: tuple[float, float]
) -> None:
    """Ideal coordinates of a span of an image row's columns, and where in the outlook stands what they see, into rows
    (4, width).

    v : local row; reach : cells along X and Y, in the marker's middle; the others as in `collect_edge_pixels`
    """
    lens, n, margin = marker.lens, marker.n, marker.margin
    width = np.uintp(rows.shape[1])
    flat = rows.reshape(rows.size)
    p, q = polynomial_along_row(lens[0], v), polynomial_along_row(lens[1], v)
    pa, pb, pc, pd, pe = np.float32(p.a), np.float32(p.b), np.float32(p.c), np.float32(p.d), np.float32(p.e)
    qa, qb, qc, qd, qe = np.float32(q.a), np.float32(q.b), np.float32(q.c), np.float32(q.d), np.float32(q.e)
    h = g.astype(np.float32)
    g00, g01, g02, g10, g11, g12, g20, g21 = h[0, 0], h[0, 1], h[0, 2], h[1, 0], h[1, 1], h[1, 2], h[2, 0], h[2, 1]
    wide, high, last, edge, white = (
        np.float32(reach[0]),
        np.float32(reach[1]),
        np.float32(n + 3.9),
        np.float32(n + 1),
        np.float32(margin),
    )
    for k in range(np.uintp(span[0]), np.uintp(span[1])):
        u = flat[k]
        xi, yi = pa + u * (pb + u * (pc + u * (pd + u * pe))), qa + u * (qb + u * (qc + u * (qd + u * qe)))
        w = _1 / (g20 * xi + g21 * yi + _1)
        X, Y = (g00 * xi + g01 * yi + g02) * w, (g10 * xi + g11 * yi + g12) * w
        rx, ry = wide * w, high * w
        X0, Y0 = min(max(X + _2, _0), last), min(max(Y + _2, _0), last)  # cells that stand for all beyond
        i, j = np.floor(X0), np.floor(Y0)
        fx, fy = X0 - i, Y0 - j
        sides = (
            (_1 if fx < rx else _0)
            + (_2 if _1 - fx < rx else _0)
            + (_4 if fy < ry else _0)
            + (_8 if _1 - fy < ry else _0)
        )
        far = max(rx, ry)
        entry = (j * _MOST + i) * _VIEWS + (sides if far < _1 else _16)
        outside = max(max(-_1 - X, X - edge), max(-_1 - Y, Y - edge))
        flat[width + k], flat[width + width + k] = xi, yi
        flat[width + width + width + k] = entry if w > _0 and outside < min(far, white - _CLEAR * far) else _NOWHERE


@inlined_kernel
def _sort(raster: Raster, count: int, seen: Floats, pixels: EdgePixels) -> int:
    """The first `count` pixels of a Raster by kind into EdgePixels; returns how many. seen : the marker's outlook"""
    first = pixels.first
    at = np.zeros(KINDS + 1, np.int64)
    for k in range(count):
        at[_OUTLOOKS[seen[raster.entries[k]], 0] + 1] += 1
    for kind in range(KINDS):
        at[kind + 1] += at[kind]
    for kind in range(KINDS + 1):  # not as one array, of which numba compiles half a second of error messages
        first[kind] = at[kind]
    for k in range(count):
        entry = raster.entries[k]
        outlook = _OUTLOOKS[seen[entry]]
        m = at[outlook[0]]
        at[outlook[0]] = m + 1
        cell = entry // VIEWS
        pixels.x[m], pixels.y[m], pixels.greys[m], pixels.looks[m] = (
            raster.x[k],
            raster.y[k],
            raster.greys[k],
            outlook[3],
        )
        pixels.i[m], pixels.j[m] = (cell & (MOST - 1)) - 2 + outlook[1], cell // MOST - 2 + outlook[2]
    return count
