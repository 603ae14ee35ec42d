"""What covers part of a square: the cells where pixels do not fit, which are left out with their neighbours.

A pixel far off counts little; one beside it, where the edge of what covers the square is blurred, fits well enough to count and is wrong.
"""

import numpy as np

from vision.corners.edges import EdgePixels
from vision.corners.gauss_newton import LIGHT
from vision.corners.jit import kernel

SHARE = 0.2  # of a cell's pixels that do not fit, from which something covers it
FEWEST = 3  # such pixels, below which they may be chance, or specks of dirt
FITS = 0.999  # of a residual that is counted whole


@kernel
def _at(point: np.ndarray, g: np.ndarray, top: int) -> tuple[int, int]:
    """(column, row) of the cell of a point (2,) in local ideal coordinates, counted from 0 and held within 0 .. top."""
    xi, yi = float(point[0]), float(point[1])
    w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
    X, Y = (g[0, 0] * xi + g[0, 1] * yi + g[0, 2]) * w, (g[1, 0] * xi + g[1, 1] * yi + g[1, 2]) * w
    return min(max(int(X + 2), 0), top), min(max(int(Y + 2), 0), top)


@kernel
def covered(pixels: EdgePixels, count: int, g: np.ndarray, rows: np.ndarray, told: np.ndarray, hidden: np.ndarray) -> bool:
    """Whether something covers part of a square; added to hidden (k, k) bool, the cells that it hides, and their neighbours.

    pixels : EdgePixels, the first `count`; g : (3, 3) homography to cells; rows : as `accumulate` leaves them; told : (2, k, k) overwritten
    """
    chunk, top = rows.shape[2], hidden.shape[0] - 1
    told[:] = 0
    for k in range(count):
        J = rows[k // chunk]
        root = J[LIGHT, k % chunk] + J[LIGHT + 3, k % chunk]  # the shares of white and of black, which a pixel that counts less has less of
        if root > 0:
            i, j = _at(pixels.points[k], g, top)
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
def uncovered(pixels: EdgePixels, count: int, g: np.ndarray, hidden: np.ndarray) -> int:
    """Keep, of the first `count` EdgePixels, those outside hidden cells (k, k), in place; returns how many. g : (3, 3) homography to cells"""
    kept, top = 0, hidden.shape[0] - 1
    for k in range(count):
        i, j = _at(pixels.points[k], g, top)
        pixels.points[kept], pixels.greys[kept], pixels.places[kept] = pixels.points[k], pixels.greys[k], pixels.places[k]
        kept += not hidden[j, i]
    return kept
