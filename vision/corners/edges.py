"""The pixels near a square's edges, collected for the fit, each with the edge or edges that it sees."""

import math
from typing import NamedTuple

import numpy as np

from vision.corners.jit import kernel
from vision.corners.local_lens import along

REACH = 3.6  # edge widths on either side of an edge that are looked at; with vision/corners/spread.py's KNOTS by the rule in tests/bench/reach.py:
# of reaches 2.4, 2.8, 3.2, 3.6 and 5, 7, 9, 11 knots the smallest within 1 % of the least corner error on exact and rendered pictures
CLEAR = 3.2  # edge widths kept clear of whatever lies beyond the white margin
NOTHING, SEVERAL = 0, 1  # then one edge: 2 + 4 axis + 2 far side + white first



class EdgePixels(NamedTuple):
    """Pixels near a marker's edges, room for k of them.

    points : (k, 2) float32, local ideal coordinates; greys : (k,) float32, 255ths of white
    places : (k, 3) int32, kind, i, j. Kind +-1: one edge X = i, white on its right (+) or left (-); +-2: one edge Y = j, white
    below (+) or above (-); 0: several edges around cell i, j
    """

    points: np.ndarray
    greys: np.ndarray
    places: np.ndarray


class Printed(NamedTuple):
    """One marker in an image: what is printed, and where it is looked for.

    cells : (n + 4, n + 4), 1 white, 0 black, the n x n bits with their black border and a ring of white; outlook : (n + 4, n + 4, 16) int8 of
    them; n : bits each way; margin : cells of white around it; directions : (2,) rows of the spread's tables for its X and its Y edges
    box : (4,) x0 y0 x1 y1 px, the part of the image cut out; lens : (2, TERMS) polynomials from local pixel to local ideal coordinates
    centre : (3,) x, y, scale px, of local coordinates
    """

    cells: np.ndarray
    outlook: np.ndarray
    n: int
    margin: float
    directions: np.ndarray
    box: np.ndarray
    lens: np.ndarray
    centre: np.ndarray


def outlook(cells: np.ndarray) -> np.ndarray:
    """(k, k, 16) int8 of cells (k, k): what a pixel of each cell sees, by which of its sides (1 left, 2 right, 4 top, 8 bottom) are in reach.

    NOTHING, SEVERAL edges, or one: 2 + 4 where it lies across (Y) + 2 where it is the right or lower side + 1 where white comes first
    """
    k = len(cells)
    at = np.arange(k)
    out = np.zeros((k, k, 16), np.int8)
    for sides in range(16):
        x = [np.maximum(at - (sides & 1 > 0), 0), at, np.minimum(at + (sides & 2 > 0), k - 1)]
        y = [np.maximum(at - (sides & 4 > 0), 0), at, np.minimum(at + (sides & 8 > 0), k - 1)]
        seen = np.array([[cells[np.ix_(v, u)] for u in x] for v in y])  # (3, 3, k, k)
        rows_alike, columns_alike = (seen == seen[1:2]).all(axis=(0, 1)), (seen == seen[:, 1:2]).all(axis=(0, 1))
        out[..., sides] = SEVERAL
        for axis, alike, low, high in ((0, rows_alike, seen[1, 0], seen[1, 2]), (1, columns_alike, seen[0, 1], seen[2, 1])):
            one = alike & ((low == cells) != (high == cells))
            far = low == cells
            out[..., sides] = np.where(one, 2 + 4 * axis + 2 * far + (far == (cells == 1)), out[..., sides])
        out[rows_alike & columns_alike, sides] = NOTHING
    return out


@kernel
def _row(quad: np.ndarray, pad: float, y: int, low: int, high: int) -> tuple[int, int]:
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
def edge_pixels(crop: np.ndarray, marker: Printed, quad: np.ndarray, g: np.ndarray, s: float, pixels: EdgePixels) -> int:
    """Collect the pixels near an edge into EdgePixels; returns how many.

    crop : (rows, columns), 255ths of white, of marker.box; marker : Printed; quad : (4, 2) px, the corners
    g : (3, 3) homography from local ideal coordinates to cells; s : px, width of the edges
    """
    cx, cy, scale = marker.centre
    box, lens, seen, n, margin = marker.box, marker.lens, marker.outlook, marker.n, marker.margin
    points, greys, places = pixels.points, pixels.greys, pixels.places
    count, row = 0, np.empty((5, crop.shape[1]))
    # cells to the pixel in the middle of the marker; perspective changes them with w, and w is followed
    Xx, Xy = g[0, 0] - 0.5 * n * g[2, 0], g[0, 1] - 0.5 * n * g[2, 1]
    Yx, Yy = g[1, 0] - 0.5 * n * g[2, 0], g[1, 1] - 0.5 * n * g[2, 1]
    reach_x = REACH * s * math.sqrt((Xx * lens[0, 1] + Xy * lens[1, 1]) ** 2 + (Xx * lens[0, 2] + Xy * lens[1, 2]) ** 2) / scale
    reach_y = REACH * s * math.sqrt((Yx * lens[0, 1] + Yy * lens[1, 1]) ** 2 + (Yx * lens[0, 2] + Yy * lens[1, 2]) ** 2) / scale
    g00, g01, g02, g10, g11, g12, g20, g21 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1]
    pad = REACH * s + 1 + 0.02 * scale  # a lens bends the sides
    for y in range(box[1], box[3]):
        v = (y - cy) / scale
        p, q = along(lens[0], v), along(lens[1], v)
        start, end = _row(quad, pad, y, box[0], box[2])
        for k in range(end - start):
            u = (start + k - cx) / scale
            xi, yi = p.a + u * (p.b + u * (p.c + u * (p.d + u * p.e))), q.a + u * (q.b + u * (q.c + u * (q.d + u * q.e)))
            w = 1 / (g20 * xi + g21 * yi + 1)
            row[0, k], row[1, k], row[2, k] = xi, yi, w
            row[3, k], row[4, k] = (g00 * xi + g01 * yi + g02) * w, (g10 * xi + g11 * yi + g12) * w
        for k in range(end - start):
            w, X, Y = row[2, k], row[3, k], row[4, k]
            rx, ry = reach_x * w, reach_y * w
            X0, Y0 = min(max(X, -2.0), n + 1.9), min(max(Y, -2.0), n + 1.9)  # cells that stand for all beyond
            i, j = int(X0 + 2) - 2, int(Y0 + 2) - 2
            fx, fy = X0 - i, Y0 - j
            sides = (fx < rx) + 2 * (1 - fx < rx) + 4 * (fy < ry) + 8 * (1 - fy < ry)
            far = max(rx, ry)
            code = seen[j + 2, i + 2, sides] if far < 1 else SEVERAL  # where cells beyond the next are in sight nobody has looked
            outside = max(max(-1 - X, X - (n + 1)), max(-1 - Y, Y - (n + 1)))
            single = code - 2
            kind = (0 if single < 0 else (1 if single < 4 else 2)) * (-1 if single & 1 else 1)
            second = single >= 0 and single & 2 != 0
            points[count, 0], points[count, 1] = row[0, k], row[1, k]
            greys[count] = crop[y - box[1], start + k - box[0]]
            places[count, 0] = kind
            places[count, 1] = i + (second and single < 4)
            places[count, 2] = j + (second and single >= 4)
            # written first and kept after, because a processor cannot guess which pixels are
            count += (code != 0) & (w > 0) & (outside < min(far, margin - CLEAR / REACH * far))
    return count
