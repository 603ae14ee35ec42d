"""What covers part of a square: the cells where pixels do not fit, which are left out with their neighbours.

A pixel far off counts little; one beside it, where the edge of what covers the square is blurred, fits well enough to
count and is wrong.
"""

import numpy as np

from vision.corners.edge_pixels import KINDS, EdgePixels
from vision.corners.numba_compilation import kernel
from vision.corners.square_gauss_newton import LIGHT

SHARE = 0.2  # of a cell's pixels that do not fit, from which something covers it
FEWEST = 3  # such pixels, below which they may be chance, or specks of dirt
FITS = 0.999  # of a residual that is counted whole


@kernel
def _at(xi: float, yi: float, g: np.ndarray, top: int) -> tuple[int, int]:
    """(column, row) of the cell of a point in local ideal coordinates, counted from 0 and held within 0 .. top."""
    w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
    X, Y = (g[0, 0] * xi + g[0, 1] * yi + g[0, 2]) * w, (g[1, 0] * xi + g[1, 1] * yi + g[1, 2]) * w
    return min(max(int(X + 2), 0), top), min(max(int(Y + 2), 0), top)


@kernel
def find_occluded_cells(
    pixels: EdgePixels, g: np.ndarray, rows: np.ndarray, told: np.ndarray, hidden: np.ndarray
) -> bool:
    """Whether something covers part of a square; added to hidden (k, k) bool, the cells that it hides, and their
    neighbours.

    pixels : EdgePixels; g : (3, 3) homography to cells; rows : as `accumulate` leaves them; told : (2, k, k)
        overwritten
    """
    strip, top, count = rows.shape[2], hidden.shape[0] - 1, pixels.first[KINDS]
    told[:] = 0
    for k in range(count):
        J = rows[k // strip]
        root = (
            J[LIGHT, k % strip] + J[LIGHT + 3, k % strip]
        )  # the shares of white and of black, which a pixel that counts less has less of
        if root > 0:
            i, j = _at(pixels.x[k], pixels.y[k], g, top)
            told[0, j, i] += 1
            told[1, j, i] += root < FITS
    found = False
    for j in range(top + 1):
        for i in range(top + 1):
            if told[1, j, i] >= FEWEST and told[1, j, i] >= SHARE * told[0, j, i]:
                hidden[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2] = True
                found = True
    return found


@kernel
def remove_occluded_pixels(pixels: EdgePixels, g: np.ndarray, hidden: np.ndarray) -> int:
    """Keep those EdgePixels that lie outside hidden cells (k, k), in place; returns how many. g : (3, 3) homography to
    cells
    """
    kept, top, start = 0, hidden.shape[0] - 1, 0
    for kind in range(KINDS):
        for k in range(start, pixels.first[kind + 1]):
            i, j = _at(pixels.x[k], pixels.y[k], g, top)
            pixels.x[kept], pixels.y[kept], pixels.greys[kept] = pixels.x[k], pixels.y[k], pixels.greys[k]
            pixels.i[kept], pixels.j[kept], pixels.looks[kept] = pixels.i[k], pixels.j[k], pixels.looks[k]
            kept += not hidden[j, i]
        start, pixels.first[kind + 1] = pixels.first[kind + 1], kept
    return kept
