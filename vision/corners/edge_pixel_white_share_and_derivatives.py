"""Predicted white share of edge pixels of a square, with derivatives.

A strip is a batch of pixels that are computed at a time.

All numbers are in single precision, a strip is one flat array, and places in it are unsigned: so compilers work out
many pixels at once.
"""

import math
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats
from vision.corners.blurred_edge_image_model_and_numba_kernels import (
    NODES,
    SKEW,
    SPAN,
    STEPS,
    TOGETHER,
    WEIGHTS,
    Meeting,
    Tables,
    cell_white_share,
    inlined_kernel,
    kernel,
    wide_edge_cell_white_share,
)
from vision.corners.edge_pixels import KINDS, LEVEL, MEETING, REACH, UPRIGHT, EdgePixels

ROWS = 16  # of a strip
STRIP = 256  # pixels in a strip; its rows fit the processor's first cache
_D_X, _D_Y, _BOTH, _WIDTH, _SHARE = (np.uintp(k * STRIP) for k in (2, 5, 6, 8, 9))  # rows that shares are left in
_R0, _R1, _R3, _R4, _R7, _R10, _R11, _R12, _R13 = (
    np.uintp(k * STRIP) for k in (0, 1, 3, 4, 7, 10, 11, 12, 13)
)  # free until greys are
_0, _1, _2 = (np.float32(k) for k in (0, 1, 2))
_HALF, _PER_WIDTH, _END = np.float32(SPAN / 2), np.float32(STEPS / SPAN), np.float32(STEPS - 0.001)
_CLOSE, _SKEW = np.float32(TOGETHER), np.float32(SKEW)
_N0, _N1, _N2 = (np.float32((node + 1) / 2) for node in NODES)
_W0, _W1, _W2 = (np.float32(weight / (4 * math.pi)) for weight in WEIGHTS)
_64, _T2, _T3, _T4, _T5, _T6 = (np.float32(1 / k) for k in (64, 2, 6, 24, 120, 720))
_LEAST = np.float32(-30)


class Seen(NamedTuple):
    """How a square is seen: g : (3, 3) homography from local ideal coordinates to cells; width : px, of edges
    slope : (2, 2) of the lens in the middle, image to ideal; cells : of `Printed`."""

    g: Floats
    width: float
    slope: Floats
    cells: Floats


@kernel
def fill_strip_white_share_and_derivatives(
    pixels: EdgePixels, start: int, size: int, view: Seen, tables: Tables, strip: Floats
) -> None:
    """Fill a strip's white share and derivatives.

    As predicted at a strip of edge pixels, into strip (ROWS * STRIP,).
    """
    first = pixels.first
    for kind in range(KINDS):
        low, high = max(first[kind] - start, 0), min(first[kind + 1] - start, size)
        if low < high:
            if kind == UPRIGHT:
                _single(0, pixels, start, low, high, view, tables.x, strip)
                for k in range(np.uintp(low), np.uintp(high)):
                    strip[_D_Y + k] = _0
            elif kind == LEVEL:
                _single(1, pixels, start, low, high, view, tables.y, strip)
                for k in range(np.uintp(low), np.uintp(high)):
                    strip[_D_Y + k] = strip[_D_X + k]
                    strip[_D_X + k] = _0
            elif kind == MEETING:
                _meetings(pixels, start, low, high, view, tables, strip)
            else:
                _several(pixels, start, low, high, view, tables, strip)


@kernel
def _look_up(table: Floats, strip: Floats, low: int, high: int, away: np.uintp, slope: np.uintp) -> None:
    """Replace distances in edge widths, at row `away` of a strip, by shares of white, and write their slopes at row
    `slope`.
    """
    for k in range(np.uintp(low), np.uintp(high)):
        at = min(max((strip[away + k] + _HALF) * _PER_WIDTH, _0), _END)
        i = np.uint32(at)
        f = at - np.float32(i)
        strip[away + k] = table[i, 0] + f * table[i, 1]
        strip[slope + k] = table[i, 2] + f * table[i, 3]


@kernel
def _single(
    axis: int, pixels: EdgePixels, start: int, low: int, high: int, seen: Seen, table: Floats, strip: Floats
) -> None:
    """The same for pixels low .. high of a strip that see one edge, across an axis, by that axis' table; the derivative
    at row 2.
    """
    lines, x, y, looks, g, slope = (
        pixels.i if axis == 0 else pixels.j,
        pixels.x,
        pixels.y,
        pixels.looks,
        seen.g,
        seen.slope,
    )
    a = g[axis]
    a0, a1, a2, g20, g21 = (
        np.float32(a[0]),
        np.float32(a[1]),
        np.float32(a[2]),
        np.float32(g[2, 0]),
        np.float32(g[2, 1]),
    )
    s00, s01, s10, s11 = (
        np.float32(slope[0, 0]),
        np.float32(slope[0, 1]),
        np.float32(slope[1, 0]),
        np.float32(slope[1, 1]),
    )
    s, begin = np.float32(seen.width), np.uintp(start)
    for k in range(np.uintp(low), np.uintp(high)):
        xi, yi, line = x[begin + k], y[begin + k], np.float32(lines[begin + k])
        w = _1 / (g20 * xi + g21 * yi + _1)
        X = (a0 * xi + a1 * yi + a2) * w
        Xx, Xy = (
            a0 - line * g20,
            a1 - line * g21,
        )  # of the edge, not of the pixel: w times the line's distance is exact so
        Xu, Xv = Xx * s00 + Xy * s10, Xx * s01 + Xy * s11
        across = np.float32(looks[begin + k]) / (s * w * math.sqrt(Xu * Xu + Xv * Xv))
        h = (X - line) * across
        strip[_D_X + k], strip[_BOTH + k], strip[_WIDTH + k], strip[_SHARE + k] = across * w, X, h, h
    _look_up(table, strip, low, high, _SHARE, _R10)
    for k in range(np.uintp(low), np.uintp(high)):
        e = strip[_R10 + k]
        d = e * strip[_D_X + k]
        strip[_D_X + k], strip[_BOTH + k], strip[_WIDTH + k] = d, -d * strip[_BOTH + k], -e * strip[_WIDTH + k]


@inlined_kernel
def _meetings(pixels: EdgePixels, start: int, low: int, high: int, seen: Seen, tables: Tables, strip: Floats) -> None:
    """The same for pixels that see an upright and a level edge meet. Their product is corrected as in
    vision/corners/blurred_edge_image_model_and_numba_kernels.py.
    """
    x, y, lines, levels, looks, slope = pixels.x, pixels.y, pixels.i, pixels.j, pixels.looks, seen.slope
    g = seen.g.astype(np.float32)
    g00, g01, g02, g10, g11, g12, g20, g21 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1]
    s00, s01, s10, s11 = (
        np.float32(slope[0, 0]),
        np.float32(slope[0, 1]),
        np.float32(slope[1, 0]),
        np.float32(slope[1, 1]),
    )
    s, begin = np.float32(seen.width), np.uintp(start)
    gu, gv = g20 * s00 + g21 * s10, g20 * s01 + g21 * s11
    for k in range(np.uintp(low), np.uintp(high)):
        xi, yi = x[begin + k], y[begin + k]
        w = _1 / (g20 * xi + g21 * yi + _1)
        X, Y = (g00 * xi + g01 * yi + g02) * w, (g10 * xi + g11 * yi + g12) * w
        Xx, Xy, Yx, Yy = g00 - X * g20, g01 - X * g21, g10 - Y * g20, g11 - Y * g21
        Xu, Xv, Yu, Yv = Xx * s00 + Xy * s10, Xx * s01 + Xy * s11, Yx * s00 + Yy * s10, Yx * s01 + Yy * s11
        aa, bb = Xu * Xu + Xv * Xv, Yu * Yu + Yv * Yv
        a, b = math.sqrt(aa), math.sqrt(bb)
        across, down = _1 / (s * a * w), _1 / (s * b * w)
        right, below = X - np.float32(lines[begin + k]), Y - np.float32(levels[begin + k])
        h = right * across / (_1 + (Xu * gu + Xv * gv) / aa * right)
        v = below * down / (_1 + (Yu * gu + Yv * gv) / bb * below)
        strip[_R0 + k], strip[_R1 + k], strip[_SHARE + k], strip[_R11 + k] = h, v, h, v
        strip[_R3 + k], strip[_R4 + k], strip[_BOTH + k], strip[_R7 + k] = across * w, down * w, X, Y
        strip[_R13 + k] = (Xu * Yu + Xv * Yv) / (a * b)
    _look_up(tables.x, strip, low, high, _SHARE, _R10)
    _look_up(tables.y, strip, low, high, _R11, _R12)
    for k in range(np.uintp(low), np.uintp(high)):
        four = looks[begin + k]
        corner, rightmost = np.float32(four & 1), np.float32(four >> 1 & 1)
        lowest, farthest = np.float32(four >> 2 & 1), np.float32(four >> 3 & 1)
        by_x, by_y, by_both = rightmost - corner, lowest - corner, corner - rightmost - lowest + farthest
        P, Q, h, v, rho = strip[_SHARE + k], strip[_R11 + k], strip[_R0 + k], strip[_R1 + k], strip[_R13 + k]
        hh, vv, hv = h * h, v * v, h * v
        more = rho * (
            _W0 * _bell(hh + vv, hv, rho * _N0)
            + _W1 * _bell(hh + vv, hv, rho * _N1)
            + _W2 * _bell(hh + vv, hv, rho * _N2)
        )
        more = more if abs(rho) > _SKEW and max(abs(h), abs(v)) < _CLOSE else _0
        p, q = (by_x + by_both * Q) * strip[_R10 + k], (by_y + by_both * P) * strip[_R12 + k]
        dX, dY = p * strip[_R3 + k], q * strip[_R4 + k]
        strip[_SHARE + k] = corner + by_x * P + by_y * Q + by_both * (P * Q + more)
        strip[_D_X + k], strip[_D_Y + k], strip[_WIDTH + k] = dX, dY, -(p * h + q * v)
        strip[_BOTH + k] = -(dX * strip[_BOTH + k] + dY * strip[_R7 + k])


@kernel
def _bell(squares: np.float32, product: np.float32, r: np.float32) -> np.float32:
    """exp(-(h^2 + v^2 - 2 r h v) / 2 (1 - r^2)) / sqrt(1 - r^2) from h^2 + v^2 and h v, by Taylor's series for a 64th,
    to 1e-6.
    """
    q = _1 - r * r
    t = max(-(squares - _2 * r * product) / (_2 * q), _LEAST) * _64
    e = _1 + t * (_1 + t * (_T2 + t * (_T3 + t * (_T4 + t * (_T5 + t * _T6)))))
    e *= e
    e *= e
    e *= e
    e *= e
    e *= e
    return np.float32(e * e / math.sqrt(q))


@inlined_kernel
def _several(pixels: EdgePixels, start: int, low: int, high: int, seen: Seen, tables: Tables, strip: Floats) -> None:
    """The same for pixels that see any number of edges, one by one."""
    g, s, slope = seen.g, seen.width, seen.slope
    g00, g01, g02, g10, g11, g12, g20, g21 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1]
    s00, s01, s10, s11 = slope[0, 0], slope[0, 1], slope[1, 0], slope[1, 1]
    gu, gv = g20 * s00 + g21 * s10, g20 * s01 + g21 * s11
    for m in range(low, high):
        xi, yi, i, j = float(pixels.x[start + m]), float(pixels.y[start + m]), pixels.i[start + m], pixels.j[start + m]
        w = 1.0 / (g20 * xi + g21 * yi + 1.0)
        X, Y = (g00 * xi + g01 * yi + g02) * w, (g10 * xi + g11 * yi + g12) * w
        Xx, Xy, Yx, Yy = g00 - X * g20, g01 - X * g21, g10 - Y * g20, g11 - Y * g21
        Xu, Xv, Yu, Yv = Xx * s00 + Xy * s10, Xx * s01 + Xy * s11, Yx * s00 + Yy * s10, Yx * s01 + Yy * s11
        ax, ay = math.sqrt(Xu * Xu + Xv * Xv), math.sqrt(Yu * Yu + Yv * Yv)
        meeting = Meeting(
            s * ax * w,
            s * ay * w,
            (Xu * Yu + Xv * Yv) / (ax * ay),
            (Xu * gu + Xv * gv) / (ax * ax),
            (Yu * gu + Yv * gv) / (ay * ay),
        )
        if REACH * max(meeting.sx, meeting.sy) > 1:
            p, dX, dY, dB = wide_edge_cell_white_share(seen.cells, i, j, X, Y, meeting, tables.x, tables.y)
        else:
            p, dX, dY, dB = cell_white_share(seen.cells, i, j, X, Y, meeting, tables.x, tables.y)
        k = np.uintp(m)
        strip[_SHARE + k], strip[_D_X + k], strip[_D_Y + k] = p, dX * w, dY * w
        strip[_BOTH + k], strip[_WIDTH + k] = -(dX * X + dY * Y) * w, dB
