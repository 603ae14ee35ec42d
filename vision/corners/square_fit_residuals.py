"""What the fit of a square leaves in its pixels: whether edges are out of place by more than noise moves them, and
their profile.
"""

import math

import numpy as np

from vision.corners.cell_whiteness import Tables, edge_whiteness
from vision.corners.edge_pixels import KINDS, LEVEL, MEETING, EdgePixels
from vision.corners.numba_compilation import kernel
from vision.corners.square_gauss_newton import Square

SIDE = 0.1  # of the information that the best seen cell's side has; one with less does not count
SIDES = (
    16  # of cells, from which it is told whether they are where they ought to be; the homography takes eight of them
)
PROFILED = 3.4  # edge widths on either side of an edge that a profile covers


@kernel
def _near(X: float, top: int) -> int:
    """Cell -2, -1, .. of a coordinate, counted from 0 and held within 0 .. top."""
    return min(max(int(X + 2), 0), top)


@kernel
def edge_segment_sums(pixels: EdgePixels, g: np.ndarray, rows: np.ndarray, x: np.ndarray, sums: np.ndarray) -> None:
    """sums (2, n + 5, n + 5, 2) over the pixels of each side of a cell, on X and on Y edges: slope times what the last
    step leaves, slope^2.

    pixels : EdgePixels; g : (3, 3) homography to cells; rows : as `accumulate` leaves them; x : the last step
    """
    first, count = pixels.first, pixels.first[KINDS]
    sums[:] = 0
    last, strip, top = rows.shape[1] - 1, rows.shape[2], sums.shape[1] - 1
    left = np.empty(strip, np.float32)
    for start in range(0, count, strip):
        J, size = rows[start // strip], min(strip, count - start)
        left[:size] = J[last, :size]
        for i in range(last):
            step = np.float32(x[i])
            for k in range(size):
                left[k] -= step * J[i, k]
        for axis in range(2):
            own = J[2 + 3 * axis]
            for k in range(max(first[axis] - start, 0), min(first[axis + 1] - start, size)):
                i, j = pixels.i[start + k] + 2, pixels.j[start + k] + 2
                sums[axis, i, j, 0] += own[k] * left[k]
                sums[axis, i, j, 1] += own[k] * own[k]
        for k in range(max(first[MEETING] - start, 0), size):
            xi, yi = pixels.x[start + k], pixels.y[start + k]
            w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
            X, Y = (g[0, 0] * xi + g[0, 1] * yi + g[0, 2]) * w, (g[1, 0] * xi + g[1, 1] * yi + g[1, 2]) * w
            i, j, column, row = _near(X + 0.5, top), _near(Y + 0.5, top), _near(X, top), _near(Y, top)
            sums[0, i, row, 0] += J[2, k] * left[k]
            sums[0, i, row, 1] += J[2, k] * J[2, k]
            sums[1, column, j, 0] += J[5, k] * left[k]
            sums[1, column, j, 1] += J[5, k] * J[5, k]


@kernel
def covariance_inflation(sums: np.ndarray, noise: float) -> float:
    """What the corners' covariance must be multiplied by, at least 1: how much more edges are out of place than noise
    moves them.

    sums : of `edge_segment_sums`; noise : grey levels. White noise leaves a cell's side as far out of place as its
    pixels' slopes say; a blur of another shape, rounding or a renderer's few samples to the pixel move neighbouring
    pixels alike, and sides farther than that.
    Source: a covariance from scores summed over clusters, Liang and Zeger 1986
    """
    square, sides, least = 0.0, 0, SIDE * sums[..., 1].max()
    for axis in range(2):
        for i in range(sums.shape[1]):
            for j in range(sums.shape[2]):
                if sums[axis, i, j, 1] > least:
                    square += sums[axis, i, j, 0] ** 2 / sums[axis, i, j, 1]
                    sides += 1
    return max(square / (noise * noise * (sides - 8)), 1.0) if sides >= SIDES else 1.0


@kernel
def residual_profile(
    pixels: EdgePixels,
    square: Square,
    bowed: np.ndarray,
    tables: Tables,
    directions: np.ndarray,
    limit: float,
    profile: np.ndarray,
) -> None:
    """Add what the fit leaves beside single edges, as a share of the contrast, to profile (d, BINS, 3): count, sum, sum
    of squares.

    pixels : EdgePixels; square : Square; bowed : (3,) sizes as in bowed.Bow; tables : Tables, of which directions (2,)
    are the rows of the profile for the X and the Y edges; limit : grey levels, of a trusted residual. A bin is a
    distance from the edge in widths, negative on the dark side.
    """
    g, s, slope, light, rows = square.g, square.width, square.slope, square.light, directions
    bins = profile.shape[1]
    for k in range(pixels.first[MEETING]):
        level = k >= pixels.first[LEVEL]
        axis, sign, at_edge, table = (
            (1, pixels.looks[k], pixels.j[k], tables.y) if level else (0, pixels.looks[k], pixels.i[k], tables.x)
        )
        xi, yi = float(pixels.x[k]), float(pixels.y[k])
        w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
        X = (g[axis, 0] * xi + g[axis, 1] * yi + g[axis, 2]) * w
        Xx, Xy = g[axis, 0] - at_edge * g[2, 0], g[axis, 1] - at_edge * g[2, 1]
        Xu, Xv = Xx * slope[0, 0] + Xy * slope[1, 0], Xx * slope[0, 1] + Xy * slope[1, 1]
        h = sign * (X - at_edge) / (s * w * math.sqrt(Xu * Xu + Xv * Xv))
        white, black = light[0] + light[1] * xi + light[2] * yi, light[3] + light[4] * xi + light[5] * yi
        at = int(math.floor((h / PROFILED + 1) * bins / 2))
        p, e = edge_whiteness(table, h)
        more = bowed[0] * xi * xi + bowed[1] * xi * yi + bowed[2] * yi * yi
        share = (pixels.greys[k] - black - more * (p + (1 - p) * light[3] / light[0])) / (white - black) - p
        if 0 <= at < bins and abs(share) * (white - black) < limit:
            profile[rows[axis], at, 0] += 1
            profile[rows[axis], at, 1] += share
            profile[rows[axis], at, 2] += share * share
