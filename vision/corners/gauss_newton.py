"""Gauss-Newton on the pixels near a square's edges: normal equations, a step, and the covariance of the corners.

Unknowns: the homography from image to cells (8), the logarithm of the edges' width (1), the grey of white and of black, each a
plane over the image (6).
"""

import math
from typing import NamedTuple

import numpy as np

from vision.corners.cholesky import factor, solve
from vision.corners.edges import REACH, EdgePixels
from vision.corners.jit import kernel
from vision.corners.pattern import Meeting, Tables, edge, pattern, wide_pattern

UNKNOWNS = 15
LIGHT = 9  # the first unknown of the greys
ROWS = 16  # the unknowns and the residual: one row each of what is multiplied out
CHUNK = 256  # pixels multiplied out at a time; their rows fit the processor's first cache
SATURATED = 254.5  # 255ths of white; a brighter pixel says only that there is at least so much light
FIRM = 0.3  # px; a step that moves corners farther leaves the width as it is
NARROWEST, WIDEST = 0.25, 6.0  # px, that an edge's width may become
OK, NO_PIXELS, SINGULAR, WANDERED, NO_CONTRAST, UNSETTLED, NOT_READ = range(7)


class Square(NamedTuple):
    """The image of a square as fitted so far.

    g : (3, 3) homography from local ideal coordinates to cells, last entry 1; width : px, of the edges
    light : (6,) grey of white, its slopes over local x and y, then those of black; slope : (2, 2) of the lens in the middle, image to ideal
    """

    g: np.ndarray
    width: float
    light: np.ndarray
    slope: np.ndarray


class Work(NamedTuple):
    """What the steps of a fit are computed in.

    H : (ROWS, ROWS) normal equations, the last row and column the residual's; L : (UNKNOWNS, UNKNOWNS) Cholesky factor; x : (UNKNOWNS,) step
    J : (8, 8) Jacobian of the corners to g; rows : (chunks, ROWS, CHUNK) float32 Jacobian of the pixels' greys, and residuals
    sizes : (k,) float32, |residual| of the pixels that are not saturated
    """

    H: np.ndarray
    L: np.ndarray
    x: np.ndarray
    J: np.ndarray
    rows: np.ndarray
    sizes: np.ndarray


class Counted(NamedTuple):
    """weights : sum of the pixels' weights; doubted : pixels that count less; told : pixels that are not saturated, the first of `sizes`."""

    weights: float
    doubted: int
    told: int


class Moved(NamedTuple):
    """moved : px, how far the step took the farthest corner; width : px, of the edges after it; status : OK or why there is no step."""

    moved: float
    width: float
    status: int


@kernel
def accumulate(pixels: EdgePixels, count: int, cells: np.ndarray, square: Square, tables: Tables, limit: float, lit: bool, work: Work) -> Counted:
    """work.H (ROWS, ROWS) = J J' over pixels, whose last row of J is the residual.

    pixels : EdgePixels, the first `count`; cells : of `Printed`; square : Square, at which J is taken; tables : Tables
    limit : grey levels, of a trusted residual; lit : whether the square's greys are known. Before that only their part of J is of use.
    """
    points, greys, places = pixels.points, pixels.greys, pixels.places
    g, s, slope, light = square.g, square.width, square.slope, square.light
    H, rows, sizes, table_x, table_y = work.H, work.rows, work.sizes, tables.x, tables.y
    H[:] = 0
    weights, doubted, told = 0.0, 0, 0
    g00, g01, g02, g10, g11, g12, g20, g21 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1]
    s00, s01, s10, s11 = slope[0, 0], slope[0, 1], slope[1, 0], slope[1, 1]
    gu, gv = g20 * s00 + g21 * s10, g20 * s01 + g21 * s11
    for start in range(0, count, CHUNK):
        size = min(CHUNK, count - start)
        J = rows[start // CHUNK]
        for k in range(size):
            xi, yi = float(points[start + k, 0]), float(points[start + k, 1])
            w = 1.0 / (g20 * xi + g21 * yi + 1.0)
            X, Y = (g00 * xi + g01 * yi + g02) * w, (g10 * xi + g11 * yi + g12) * w
            kind, i, j = places[start + k, 0], places[start + k, 1], places[start + k, 2]
            p, dX, dY, dB = 0.0, 0.0, 0.0, 0.0
            if kind == 0:
                Xx, Xy, Yx, Yy = g00 - X * g20, g01 - X * g21, g10 - Y * g20, g11 - Y * g21
                Xu, Xv, Yu, Yv = Xx * s00 + Xy * s10, Xx * s01 + Xy * s11, Yx * s00 + Yy * s10, Yx * s01 + Yy * s11
                ax, ay = math.sqrt(Xu * Xu + Xv * Xv), math.sqrt(Yu * Yu + Yv * Yv)
                meeting = Meeting(s * ax * w, s * ay * w, (Xu * Yu + Xv * Yv) / (ax * ay), (Xu * gu + Xv * gv) / (ax * ax),
                                  (Yu * gu + Yv * gv) / (ay * ay))
                if REACH * max(meeting.sx, meeting.sy) > 1:
                    p, dX, dY, dB = wide_pattern(cells, i, j, X, Y, meeting, table_x, table_y)
                else:
                    p, dX, dY, dB = pattern(cells, i, j, X, Y, meeting, table_x, table_y)
            elif abs(kind) == 1:
                Xx, Xy = g00 - i * g20, g01 - i * g21  # of the edge, not of the pixel: w times the line's distance is exact so
                Xu, Xv = Xx * s00 + Xy * s10, Xx * s01 + Xy * s11
                across = kind / (s * w * math.sqrt(Xu * Xu + Xv * Xv))
                h = (X - i) * across
                p, e = edge(table_x, h)
                dX, dB = e * across, -e * h
            else:
                Yx, Yy = g10 - j * g20, g11 - j * g21
                Yu, Yv = Yx * s00 + Yy * s10, Yx * s01 + Yy * s11
                across = 0.5 * kind / (s * w * math.sqrt(Yu * Yu + Yv * Yv))
                h = (Y - j) * across
                p, e = edge(table_y, h)
                dY, dB = e * across, -e * h
            white, black = light[0] + light[1] * xi + light[2] * yi, light[3] + light[4] * xi + light[5] * yi
            q, root = 1 - p, 1.0
            r = greys[start + k] - white * p - black * q
            if greys[start + k] > SATURATED and r < 0:
                root = 0.0  # it may be brighter than it can say
            else:
                sizes[told] = abs(r)
                told += 1
                if lit and abs(r) > limit:
                    root = limit / abs(r)
                    root *= math.sqrt(root)
                    doubted += 1
            weights += root * root
            contrast = (white - black) * root
            dX, dY, dB, p, q = dX * w * contrast, dY * w * contrast, dB * contrast, p * root, q * root
            both = -(dX * X + dY * Y)
            J[0, k], J[1, k], J[2, k] = dX * xi, dX * yi, dX
            J[3, k], J[4, k], J[5, k] = dY * xi, dY * yi, dY
            J[6, k], J[7, k], J[8, k] = both * xi, both * yi, dB
            J[9, k], J[10, k], J[11, k] = p, p * xi, p * yi
            J[12, k], J[13, k], J[14, k] = q, q * xi, q * yi
            J[15, k] = r * root
        for i in range(0 if lit else LIGHT, ROWS):
            for j in range(i, ROWS):
                total = np.float32(0)
                for k in range(size):
                    total += J[i, k] * J[j, k]
                H[i, j] += total
    for i in range(ROWS):
        for j in range(i):
            H[i, j] = H[j, i]
    return Counted(weights, doubted, told)


@kernel
def corners_at(g: np.ndarray, n: int, corners: np.ndarray, J: np.ndarray) -> bool:
    """Local ideal coordinates (4, 2) of the square's corners and their Jacobian (8, 8) to g; False where it has turned over."""
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
def step(square: Square, n: int, scale: float, corners: np.ndarray, work: Work) -> Moved:
    """Move the square's g and light in place by a Gauss-Newton step.

    square : Square; n : bits each way; scale : px, of local coordinates; corners : (4, 2), overwritten; work : Work as accumulated
    """
    g, s, light = square.g, square.width, square.light
    H, L, x, J = work.H, work.L, work.x, work.J
    if not factor(H, 0, UNKNOWNS, L):
        return Moved(0.0, s, SINGULAR)
    solve(L, UNKNOWNS, H[ROWS - 1], x)
    if not corners_at(g, n, corners, J):
        return Moved(0.0, s, WANDERED)
    moved = 0.0
    for c in range(4):
        du, dv = 0.0, 0.0
        for k in range(8):
            du += J[2 * c, k] * x[k]
            dv += J[2 * c + 1, k] * x[k]
        moved = max(moved, scale * math.sqrt(du * du + dv * dv))
    if not moved < 1e6:
        return Moved(0.0, s, SINGULAR)
    short = min(1.0, 0.5 * scale / ((n + 2) * max(moved, 1e-9)))  # never much more than half a cell at once
    for k in range(8):
        g[k // 3, k % 3] += short * x[k]
    for k in range(6):
        light[k] += x[LIGHT + k]
    change = min(max(x[8], -0.3), 0.3) if moved < FIRM else 0.0  # edges out of place look wide
    return Moved(short * moved, min(max(s + change * s, NARROWEST), WIDEST), OK)


@kernel
def corner_covariance(work: Work, noise2: float, gain: np.ndarray, own: np.ndarray, covariance: np.ndarray) -> None:
    """Write the (8, 8) covariance of the corners' local ideal coordinates.

    work : Work of the last step, whose x is overwritten; noise2 : variance of the residuals; gain, own : as in bowed.Bow
    """
    L, x, J = work.L, work.x, work.J
    unit, row, bowed = np.empty(UNKNOWNS), np.empty(8), np.zeros((8, len(own)))
    for a in range(8):
        for t in range(len(own)):
            for k in range(8):
                bowed[a, t] += J[a, k] * gain[t, k]
    for a in range(8):
        unit[:] = 0
        unit[:8] = J[a]
        solve(L, UNKNOWNS, unit, x)
        for b in range(8):
            row[b] = 0
            for k in range(8):
                row[b] += J[b, k] * x[k]
            for s in range(len(own)):
                for t in range(len(own)):
                    row[b] += bowed[a, s] * own[s, t] * bowed[b, t]
        covariance[a] = noise2 * row
