"""Image model of blurred edges (white share of a cell), and numba kernels.

The share is from 0 to 1, in and around the cell, by edge spread functions.

Source: bivariate normal, Drezner and Wesolowsky 1990
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.compute.numba_compilation_and_kernel_cache_folder import CompilerOptions, Kernel

_OPTIONS: CompilerOptions = {"cache": True, "nogil": True, "error_model": "numpy"}

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Decorator: a function as a numba kernel.

    Compiled at its first call or loaded from an earlier run.
    """
    return cast(F, Kernel(function, _OPTIONS))


def inlined_kernel(function: F) -> F:
    """Decorator: a function as an inlined numba kernel.

    It is inlined into the one kernel that calls it.
    """
    return cast(F, Kernel(function, {**_OPTIONS, "inline": "always"}))


@kernel
def fill_cholesky_factor(H: Floats, first: int, size: int, L: Floats) -> bool:
    """Fill L with the Cholesky factor of H[first:first + size, first:first + size]; False if not definite.

    H, L : (n, n)
    """
    for i in range(size):
        for j in range(i + 1):
            total = H[first + i, first + j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 1e-9 * H[first + i, first + i]:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@kernel
def fill_cholesky_solution(L: Floats, size: int, b: Floats, x: Floats) -> None:
    """Solve L L' x = b for x (size,), with the Cholesky factor L."""
    for i in range(size):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(size - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, size):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


HALVINGS = 14  # of the numbers' range


@kernel
def order_statistic(values: Floats, rank: int) -> float:
    """Order statistic of values (k,).

    The one of that rank, to a 16 000th of their range; 0 for none.
    """
    if len(values) == 0:
        return 0.0
    low = high = float(values[0])
    for value in values:
        low, high = min(low, value), max(high, value)
    for _ in range(HALVINGS):
        middle, below = 0.5 * (low + high), 0
        for value in values:
            below += value < middle
        low, high = (middle, high) if below <= rank else (low, middle)
    return high


STEPS, SPAN = 512, 10.0  # a tabulated edge reaches from -SPAN / 2 to SPAN / 2 widths
TOGETHER = 3.0  # edge widths from two edges at once within which their meeting matters
SKEW = 0.02  # cosine between two edges' normals, below which their meeting is the product of both
GRID = np.linspace(-SPAN / 2, SPAN / 2, STEPS + 1)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)


class Tables(NamedTuple):
    """Edge spread functions of a marker's X and of its Y edges, each (STEPS, 4) float32: over the steps of GRID the
    share of white, what it gains over one, its slope, what that gains."""

    x: Floats
    y: Floats


class Meeting(NamedTuple):
    """How a marker's edges look at one place. sx, sy : cells, widths of its X and Y edges; rho : correlation, the
    cosine between their normals
    px, py : 1/cell, by what share of itself an edge's distance is less for each cell that it is nearer: perspective."""

    sx: float
    sy: float
    rho: float
    px: float
    py: float


class Share(NamedTuple):
    """Share of white at a place, and its derivatives to X and Y (per cell) and to the logarithm of the edges' width."""

    white: float
    by_X: float
    by_Y: float
    by_width: float


@kernel
def fill_edge_spread_table(function: Floats, table: Floats) -> None:
    """Fill a table (STEPS, 4) with an edge spread function (STEPS + 1, 2).

    Share of white and slope.
    """
    for k in range(len(table)):
        for q in range(2):
            table[k, 2 * q], table[k, 2 * q + 1] = function[k, q], function[k + 1, q] - function[k, q]


@kernel
def edge_white_share_and_slope(table: Floats, x: float) -> tuple[float, float]:
    """White share and its slope at x edge widths from an edge, looked up in a table (STEPS, 4)."""
    at = min(max((x + SPAN / 2) * (STEPS / SPAN), 0.0), STEPS - 1e-6)
    i = int(at)
    f = at - i
    return float(table[i, 0]) + f * table[i, 1], float(table[i, 2]) + f * table[i, 3]


@kernel
def _edge_distance(cells: float, s: float, p: float) -> float:
    """Edge widths from an edge so many cells away, where an edge is s cells wide here and perspective changes cells by
    p: the line's distance in the image, not the nearest guess at it, which shifts every edge of a tilted marker the
    same way."""
    return cells / (s * (1 + p * cells))


@kernel
def _meeting(h: float, k: float, rho: float) -> float:
    """Bivariate normal distribution less the product of its margins."""
    total = 0.0
    for g in range(3):
        r = 0.5 * rho * (NODES[g] + 1)
        q = 1 - r * r
        total += WEIGHTS[g] * math.exp(-(h * h - 2 * r * h * k + k * k) / (2 * q)) / math.sqrt(q)
    return total * rho / (4 * math.pi)


@kernel
def cell_white_share(
    cells: Floats, i: int, j: int, X: float, Y: float, meeting: Meeting, table_x: Floats, table_y: Floats
) -> Share:
    """White share at cell coordinates X, Y of a cell (i, j).

    They are in or next to the cell; it is by the spread of its edges.
    cells : (n + 4, n + 4), the n x n bits with their black border and one more ring of white. Cell (0, 0) is the first
        bit.
    """
    sx, sy, rho, px, py = meeting
    last = cells.shape[0] - 1
    hl, hr, vl, vr = (
        _edge_distance(X - i, sx, px),
        _edge_distance(X - i - 1, sx, px),
        _edge_distance(Y - j, sy, py),
        _edge_distance(Y - j - 1, sy, py),
    )
    Pa, pa = edge_white_share_and_slope(table_x, hl)
    Pb, pb = edge_white_share_and_slope(table_x, hr)
    Pc, pc = edge_white_share_and_slope(table_y, vl)
    Pd, pd = edge_white_share_and_slope(table_y, vr)
    y0, y1, y2 = min(max(j + 1, 0), last), min(max(j + 2, 0), last), min(max(j + 3, 0), last)
    x0, x1, x2 = min(max(i + 1, 0), last), min(max(i + 2, 0), last), min(max(i + 3, 0), last)
    s, gx, gy, gb = 0.0, 0.0, 0.0, 0.0
    for v in range(3):
        if v == 0:
            y, w, dw, bw = y0, 1 - Pc, -pc / sy, pc * vl
        elif v == 1:
            y, w, dw, bw = y1, Pc - Pd, (pc - pd) / sy, pd * vr - pc * vl
        else:
            y, w, dw, bw = y2, Pd, pd / sy, -pd * vr
        a, b, c = cells[y, x0], cells[y, x1], cells[y, x2]
        row = a + (b - a) * Pa + (c - b) * Pb
        s += w * row
        gx += w * ((b - a) * pa + (c - b) * pb) / sx
        gy += dw * row
        gb += bw * row - w * ((b - a) * pa * hl + (c - b) * pb * hr)
    if abs(rho) > SKEW:
        for u in range(2):
            h, left, right = (hl, x0, x1) if u == 0 else (hr, x1, x2)
            for v in range(2):
                k, top, bottom = (vl, y0, y1) if v == 0 else (vr, y1, y2)
                w = cells[top, left] - cells[top, right] - cells[bottom, left] + cells[bottom, right]
                if w != 0 and abs(h) < TOGETHER and abs(k) < TOGETHER:
                    s += w * _meeting(h, k, rho)
    return Share(s, gx, gy, gb)


@kernel
def wide_edge_cell_white_share(
    cells: Floats, i: int, j: int, X: float, Y: float, meeting: Meeting, table_x: Floats, table_y: Floats
) -> Share:
    """White share of a cell with wide edges.

    They are so wide that cells beyond the neighbours count.
    cells : (n, n) grey levels; X, Y : px, where they begin; table_x, table_y : (k,) of the edge's spread
    """
    sx, sy, rho, px, py = meeting
    last = cells.shape[0] - 1
    h = (
        _edge_distance(X - i + 1, sx, px),
        _edge_distance(X - i, sx, px),
        _edge_distance(X - i - 1, sx, px),
        _edge_distance(X - i - 2, sx, px),
    )
    k = (
        _edge_distance(Y - j + 1, sy, py),
        _edge_distance(Y - j, sy, py),
        _edge_distance(Y - j - 1, sy, py),
        _edge_distance(Y - j - 2, sy, py),
    )
    across = (
        edge_white_share_and_slope(table_x, h[0]),
        edge_white_share_and_slope(table_x, h[1]),
        edge_white_share_and_slope(table_x, h[2]),
        edge_white_share_and_slope(table_x, h[3]),
    )
    down = (
        edge_white_share_and_slope(table_y, k[0]),
        edge_white_share_and_slope(table_y, k[1]),
        edge_white_share_and_slope(table_y, k[2]),
        edge_white_share_and_slope(table_y, k[3]),
    )
    s, gx, gy, gb, above = 0.0, 0.0, 0.0, 0.0, 0.0
    for v in range(5):
        y = min(max(j + v, 0), last)
        a = cells[y, min(max(i, 0), last)]
        row, slope, spread = a, 0.0, 0.0
        for u in range(4):
            b = cells[y, min(max(i + u + 1, 0), last)]
            row += (b - a) * across[u][0]
            slope += (b - a) * across[u][1] / sx
            spread -= (b - a) * across[u][1] * h[u]
            a = b
        w = (down[v - 1][0] if v > 0 else 1.0) - (down[v][0] if v < 4 else 0.0)
        s += w * row
        gx += w * slope
        gb += w * spread
        if v > 0:
            gy += (row - above) * down[v - 1][1] / sy
            gb -= (row - above) * down[v - 1][1] * k[v - 1]
        above = row
    if abs(rho) > SKEW:
        for u in range(4):
            left, right = min(max(i + u, 0), last), min(max(i + u + 1, 0), last)
            for v in range(4):
                top, bottom = min(max(j + v, 0), last), min(max(j + v + 1, 0), last)
                w = cells[top, left] - cells[top, right] - cells[bottom, left] + cells[bottom, right]
                if w != 0 and abs(h[u]) < TOGETHER and abs(k[v]) < TOGETHER:
                    s += w * _meeting(h[u], k[v], rho)
    return Share(s, gx, gy, gb)
