"""Gauss-Newton steps of the square fit.

Normal equations, step, covariance of the corners.

Unknowns: the homography from image to cells (8), the logarithm of the edges' width (1), the grey of white and of black,
each a plane over the image (6).
"""

import math
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats
from vision.corners.blurred_edge_image_model_and_numba_kernels import (
    Tables,
    fill_cholesky_factor,
    fill_cholesky_solution,
    inlined_kernel,
    kernel,
)
from vision.corners.edge_pixel_white_share_and_derivatives import (
    ROWS,
    STRIP,
    Seen,
    fill_strip_white_share_and_derivatives,
)
from vision.corners.edge_pixels import KINDS, EdgePixels

UNKNOWNS = 15
LIGHT = 9  # the first unknown of the greys
UNLIMITED = 1e9  # grey levels, in place of a limit of residuals while their scatter is not known
SATURATED = 254.5  # 255ths of white; a brighter pixel says only that there is at least so much light
FIRM = 0.3  # px; a step that moves corners farther leaves the width as it is
NARROWEST, WIDEST = 0.25, 6.0  # px, that an edge's width may become
OK, NO_PIXELS, SINGULAR, WANDERED, NO_CONTRAST, UNSETTLED, NOT_READ = range(7)
PADDED = 32  # pixels; strips end in zeros up to a multiple of so many
_0, _1, _SATURATED = np.float32(0), np.float32(1), np.float32(SATURATED)
_R = tuple(np.uintp(k * STRIP) for k in range(ROWS))


class Square(NamedTuple):
    """The image of a square as fitted so far.

    g : (3, 3) homography from local ideal coordinates to cells, last entry 1; width : px, of the edges
    light : (6,) grey of white, its slopes over local x and y, then those of black; slope : (2, 2) of the lens in the
        middle, image to ideal
    """

    g: Floats
    width: float
    light: Floats
    slope: Floats


class Work(NamedTuple):
    """What the steps of a fit are computed in.

    H : (ROWS, ROWS) normal equations, the last row and column the residual's; L : (UNKNOWNS, UNKNOWNS) Cholesky factor;
        x : (UNKNOWNS,) step
    J : (8, 8) Jacobian of the corners to g; rows : (strips, ROWS, STRIP) float32 Jacobian of the pixels' greys, and
        residuals
    sizes : (k,) float32, |residual| of the pixels, -1 of those that are saturated
    """

    H: Floats
    L: Floats
    x: Floats
    J: Floats
    rows: Floats
    sizes: Floats


class Counted(NamedTuple):
    """weights : sum of the pixels' weights; doubted : pixels that count less."""

    weights: float
    doubted: int


class Moved(NamedTuple):
    """moved : px, how far the step took the farthest corner; width : px, of the edges after it; status : OK or why
    there is no step.
    """

    moved: float
    width: float
    status: int


@kernel
def accumulate_normal_equations(
    pixels: EdgePixels, cells: Floats, square: Square, tables: Tables, limit: float, lit: bool, work: Work
) -> Counted:
    """Accumulate the normal equations work.H = J J' over pixels.

    The last row of J is the residual.
    pixels : EdgePixels; cells : of `Printed`; square : Square, at which J is taken; tables : Tables
    limit : grey levels, of a trusted residual; lit : whether the square's greys are known. Before that only their part
        of J is of use.
    """
    H, count = work.H, pixels.first[KINDS]
    H[:] = 0
    weights, doubted, seen = 0.0, 0, Seen(square.g, square.width, square.slope, cells)
    for start in range(0, count, STRIP):
        size = min(STRIP, count - start)
        strip = work.rows[start // STRIP].reshape(ROWS * STRIP)
        fill_strip_white_share_and_derivatives(pixels, start, size, seen, tables, strip)
        counted = _greys(pixels, start, size, square.light, limit if lit else UNLIMITED, strip, work.sizes)
        weights, doubted = weights + counted.weights, doubted + counted.doubted
        _multiply(strip, size, 0 if lit else LIGHT - 1, H)
    for i in range(ROWS):
        for j in range(i):
            H[i, j] = H[j, i]
    return Counted(weights, doubted)


@inlined_kernel
def _greys(
    pixels: EdgePixels, start: int, size: int, light: Floats, limit: float, strip: Floats, sizes: Floats
) -> Counted:
    """Rows of J from the shares in a strip (ROWS * STRIP,) of the pixels start .. start + size; zeros up to a multiple
    of PADDED pixels.

    light : as in Square; limit : as in `accumulate_normal_equations`; sizes : of Work
    """
    x, y, greys, begin = pixels.x, pixels.y, pixels.greys, np.uintp(start)
    white, white_x, white_y = np.float32(light[0]), np.float32(light[1]), np.float32(light[2])
    black, black_x, black_y = np.float32(light[3]), np.float32(light[4]), np.float32(light[5])
    most, weights, doubted = np.float32(limit), _0, _0
    for k in range(np.uintp(size)):
        xi, yi, grey, p = x[begin + k], y[begin + k], greys[begin + k], strip[_R[9] + k]
        bright, dark, q = white + white_x * xi + white_y * yi, black + black_x * xi + black_y * yi, _1 - p
        r = grey - bright * p - dark * q
        dull = grey > _SATURATED and r < _0  # it may be brighter than it can say
        off = abs(r)
        share = most / max(off, most)
        root = _0 if dull else share * math.sqrt(share)
        sizes[begin + k] = -_1 if dull else off
        doubted += _1 if off > most and not dull else _0
        weights += root * root
        contrast = (bright - dark) * root
        dX, dY, both, p, q = (
            strip[_R[2] + k] * contrast,
            strip[_R[5] + k] * contrast,
            strip[_R[6] + k] * contrast,
            p * root,
            q * root,
        )
        strip[k], strip[_R[1] + k], strip[_R[2] + k] = dX * xi, dX * yi, dX
        strip[_R[3] + k], strip[_R[4] + k], strip[_R[5] + k] = dY * xi, dY * yi, dY
        strip[_R[6] + k], strip[_R[7] + k], strip[_R[8] + k] = both * xi, both * yi, strip[_R[8] + k] * contrast
        strip[_R[9] + k], strip[_R[10] + k], strip[_R[11] + k] = p, p * xi, p * yi
        strip[_R[12] + k], strip[_R[13] + k], strip[_R[14] + k] = q, q * xi, q * yi
        strip[_R[15] + k] = r * root
    for i in range(ROWS):
        for m in range(i * STRIP + size, i * STRIP + min(STRIP, (size + PADDED - 1) // PADDED * PADDED)):
            strip[m] = 0
    return Counted(float(weights), int(doubted))


@inlined_kernel
def _multiply(strip: Floats, size: int, first: int, H: Floats) -> None:
    """Add the products of the rows of a strip (ROWS * STRIP,), from an even one on, to the upper half of H (ROWS,
    ROWS), four sums at a time.
    """
    end = np.uintp((size + PADDED - 1) // PADDED * PADDED)
    for i in range(first, ROWS, 2):
        for j in range(i, ROWS, 2):
            a, b, c, d = np.uintp(i * STRIP), np.uintp((i + 1) * STRIP), np.uintp(j * STRIP), np.uintp((j + 1) * STRIP)
            ac = ad = bc = bd = _0
            for k in range(end):
                ac += strip[a + k] * strip[c + k]
                ad += strip[a + k] * strip[d + k]
                bc += strip[b + k] * strip[c + k]
                bd += strip[b + k] * strip[d + k]
            H[i, j] += ac
            H[i, j + 1] += ad
            H[i + 1, j] += bc
            H[i + 1, j + 1] += bd


@kernel
def fill_homography_corners_and_jacobian(g: Floats, n: int, corners: Floats, J: Floats) -> bool:
    """Corners (4, 2) of a homography g in local ideal coordinates, and Jacobian (8, 8).

    False if turned over.
    """
    for c in range(4):
        X = -1.0 if c == 0 or c == 3 else n + 1.0
        Y = -1.0 if c < 2 else n + 1.0
        a0, a1, a2 = g[0, 0] - X * g[2, 0], g[0, 1] - X * g[2, 1], g[0, 2] - X
        b0, b1, b2 = g[1, 0] - Y * g[2, 0], g[1, 1] - Y * g[2, 1], g[1, 2] - Y
        det = a0 * b1 - a1 * b0
        if not abs(det) > 1e-12:
            return False
        x, y = (a1 * b2 - b1 * a2) / det, (b0 * a2 - a0 * b2) / det
        if not (g[2, 0] * x + g[2, 1] * y + 1) * det > 0:
            return False
        corners[c, 0], corners[c, 1] = x, y
        for k in range(8):
            point = x if k % 3 == 0 else (y if k % 3 == 1 else 1.0)
            to_X = point if k < 3 else (-X * point if k > 5 else 0.0)
            to_Y = 0.0 if k < 3 else (-Y * point if k > 5 else point)
            J[2 * c, k], J[2 * c + 1, k] = (a1 * to_Y - b1 * to_X) / det, (b0 * to_X - a0 * to_Y) / det
    return True


@kernel
def gauss_newton_step(square: Square, bit_count: int, local_scale: float, corners: Floats, work: Work) -> Moved:
    """Gauss-Newton step of the square's homography and light, in place.

    square : Square; bit_count : bits each way; local_scale : px, of local coordinates; corners : (4, 2), overwritten
    work : Work as accumulated
    """
    g, s, light = square.g, square.width, square.light
    H, L, x, J = work.H, work.L, work.x, work.J
    if not fill_cholesky_factor(H, 0, UNKNOWNS, L):
        return Moved(0.0, s, SINGULAR)
    fill_cholesky_solution(L, UNKNOWNS, H[ROWS - 1], x)
    if not fill_homography_corners_and_jacobian(g, bit_count, corners, J):
        return Moved(0.0, s, WANDERED)
    moved = 0.0
    for c in range(4):
        du, dv = 0.0, 0.0
        for k in range(8):
            du += J[2 * c, k] * x[k]
            dv += J[2 * c + 1, k] * x[k]
        moved = max(moved, local_scale * math.sqrt(du * du + dv * dv))
    if not moved < 1e6:
        return Moved(0.0, s, SINGULAR)
    short = min(1.0, 0.5 * local_scale / ((bit_count + 2) * max(moved, 1e-9)))  # at most about half a cell at once
    for k in range(8):
        g[k // 3, k % 3] += short * x[k]
    for k in range(6):
        light[k] += x[LIGHT + k]
    change = min(max(x[8], -0.3), 0.3) if moved < FIRM else 0.0  # edges out of place look wide
    return Moved(short * moved, min(max(s + change * s, NARROWEST), WIDEST), OK)


@kernel
def fill_corner_covariance(work: Work, noise2: float, gain: Floats, own: Floats, covariance: Floats) -> None:
    """Fill `covariance` (8, 8) with that of the corners' local ideal coordinates.

    work : Work of the last step, whose x is overwritten; noise2 : variance of the residuals; gain, own : as in
        bowed.Bow
    """
    L, x, J = work.L, work.x, work.J
    unit, row, bowed = np.empty(UNKNOWNS), np.empty(8), np.zeros((8, len(own)))
    for a in range(8):
        for t in range(len(own)):
            for k in range(8):
                bowed[a, t] += J[a, k] * gain[t, k]
    for a in range(8):
        unit[:] = 0
        for k in range(8):
            unit[k] = J[a, k]
        fill_cholesky_solution(L, UNKNOWNS, unit, x)
        for b in range(8):
            row[b] = 0
            for k in range(8):
                row[b] += J[b, k] * x[k]
            for s in range(len(own)):
                for t in range(len(own)):
                    row[b] += bowed[a, s] * own[s, t] * bowed[b, t]
        for b in range(8):
            covariance[a, b] = noise2 * row[b]
