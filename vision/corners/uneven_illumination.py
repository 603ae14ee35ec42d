"""Light that is bowed over a square, as lenses' vignetting and near lamps bow it: what planes of grey leave, taken out
of a fit by one last step.

Planes alone make every square seem larger where light falls off to all sides (by 0.002 px where vignetting takes 30 %
in an image's corners, whatever the noise), smaller where it gathers.
"""

from typing import NamedTuple

import numpy as np

from vision.corners.cholesky import factor, solve
from vision.corners.edge_pixels import KINDS, EdgePixels
from vision.corners.numba_compilation import kernel, kernel_part
from vision.corners.square_gauss_newton import LIGHT, UNKNOWNS, Square, Work
from vision.corners.strip_whiteness import ROWS, STRIP

TERMS = 3  # x^2, x y, y^2 of local coordinates, which reach to about 1 on either side of a square's middle
PLAUSIBLE = 0.02  # of the grey of white, that light may be bowed by from a square's middle to its rim


class Bow(NamedTuple):
    """gain : (TERMS, UNKNOWNS) by how much a fit's unknowns fall with each term; own : (TERMS, TERMS) the terms'
    covariance, over the noise's
    sizes : (TERMS,) grey levels, the terms."""

    gain: np.ndarray
    own: np.ndarray
    sizes: np.ndarray


@kernel
def remove_uneven_illumination(pixels: EdgePixels, square: Square, weights: float, work: Work, found: Bow) -> float:
    """Take bowed light out of a fit whose last step was made: its Square moves on, and work.x and the residuals in
    work.rows with it.

    pixels : EdgePixels, of all of which work holds rows; weights : sum of their weights; found : Bow, overwritten
    Returns the weighted square of the residuals that is left, grey levels
    """
    gain, own, sizes, light = found.gain, found.own, found.sizes, square.light
    H, L, x, rows, count = work.H, work.L, work.x, work.rows, pixels.first[KINDS]
    left = H[ROWS - 1, ROWS - 1]
    for k in range(UNKNOWNS):
        left -= H[ROWS - 1, k] * x[k]
    held = max(left, 1e-12) / max(weights - UNKNOWNS, 1.0) / (PLAUSIBLE * light[0]) ** 2
    black = light[3] / light[0]
    cross, within, E = np.zeros((TERMS, ROWS)), np.zeros((TERMS, TERMS)), np.empty((TERMS, STRIP), np.float32)
    _products(pixels, rows, black, E, cross, within)
    right, M, unit = np.empty(TERMS), np.empty((TERMS, TERMS)), np.empty(TERMS)
    for a in range(TERMS):
        solve(L, UNKNOWNS, cross[a], gain[a])
        right[a] = cross[a, ROWS - 1]
        for k in range(UNKNOWNS):
            right[a] -= cross[a, k] * x[k]
    for a in range(TERMS):
        for b in range(a, TERMS):
            for k in range(UNKNOWNS):
                within[a, b] -= cross[a, k] * gain[b, k]
            within[b, a] = within[a, b]
        within[a, a] += held
    own[:], sizes[:] = 0, 0
    if not factor(within, 0, TERMS, M):
        return left
    solve(M, TERMS, right, sizes)
    for a in range(TERMS):
        unit[:] = 0
        unit[a] = 1
        solve(M, TERMS, unit, own[a])
        left -= right[a] * sizes[a]
        for k in range(UNKNOWNS):
            x[k] -= gain[a, k] * sizes[a]
        for k in range(8):
            square.g[k // 3, k % 3] -= gain[a, k] * sizes[a]
        for k in range(6):
            light[k] -= gain[a, LIGHT + k] * sizes[a]
    for start in range(0, count, STRIP):
        J, size = rows[start // STRIP], min(STRIP, count - start)
        _bowed(pixels, start, size, black, J, E)
        for a in range(TERMS):
            for k in range(size):
                J[ROWS - 1, k] -= np.float32(sizes[a]) * E[a, k]
    return left


@kernel_part
def _products(
    pixels: EdgePixels, rows: np.ndarray, black: float, E: np.ndarray, cross: np.ndarray, within: np.ndarray
) -> None:
    """Add to cross (TERMS, ROWS) and to within (TERMS, TERMS), above its diagonal, sums of what bowed light does to all
    pixels times their rows,
    and times itself. E : overwritten"""
    count = pixels.first[KINDS]
    for start in range(0, count, STRIP):
        J, size = rows[start // STRIP], min(STRIP, count - start)
        _bowed(pixels, start, size, black, J, E)
        for a in range(TERMS):
            for i in range(ROWS):
                total = np.float32(0)
                for k in range(size):
                    total += E[a, k] * J[i, k]
                cross[a, i] += total
            for b in range(a, TERMS):
                total = np.float32(0)
                for k in range(size):
                    total += E[a, k] * E[b, k]
                within[a, b] += total


@kernel
def _bowed(pixels: EdgePixels, start: int, size: int, black: float, J: np.ndarray, E: np.ndarray) -> None:
    """E (TERMS, STRIP) what bowed light does to the pixels start .. start + size, whose rows are J. black : grey of
    black over that of white
    """
    for k in range(size):
        u, v = pixels.x[start + k], pixels.y[start + k]
        share = J[LIGHT, k] + np.float32(black) * J[LIGHT + 3, k]
        E[0, k], E[1, k], E[2, k] = share * u * u, share * u * v, share * v * v
