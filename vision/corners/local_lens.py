"""A lens near one marker: cubic polynomials from pixels to ideal image coordinates, interpolated from a table made once per camera."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rig.design import Camera
from vision import lens
from vision.corners.jit import kernel

SPACING = 32.0  # px between the table's nodes; four of them to each side interpolate a lens of photographs to 1e-5 px
BEYOND = 4  # nodes outside the image
_SPREAD = 1.2  # half widths of a marker over which its polynomials hold
_ORDERS = np.array([[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3]])
_NODES = _SPREAD * np.stack(np.meshgrid(*[np.cos(np.pi * (np.arange(5) + 0.5) / 5)] * 2), axis=-1).reshape(-1, 2)
_TO_POLYNOMIAL = np.linalg.pinv((_NODES[:, None, :] ** _ORDERS).prod(axis=2))


def table(camera: Camera) -> np.ndarray:
    """(rows, columns, 2) ideal coordinates of nodes SPACING px apart from -BEYOND * SPACING on, times the focal lengths; NaN beyond a lens."""
    return _table(camera.matrix.tobytes(), np.asarray(camera.distortion, float).tobytes(), camera.width, camera.height)


@lru_cache(maxsize=64)
def _table(matrix: bytes, distortion: bytes, width: int, height: int) -> np.ndarray:
    K = np.frombuffer(matrix).reshape(3, 3)
    u, v = (SPACING * np.arange(-BEYOND, int(size / SPACING) + BEYOND + 2) for size in (width, height))
    ideal = lens.undistort(np.stack(np.meshgrid(u, v), axis=-1), K, np.frombuffer(distortion))
    return ideal * K[[0, 1], [0, 1]]


@kernel
def _at(nodes: np.ndarray, x: float, y: float) -> tuple[float, float]:
    """The table's value at pixel x, y: cubic through four nodes each way (Lagrange)."""
    x, y = x / SPACING + BEYOND, y / SPACING + BEYOND
    i, j = min(max(int(x), 1), nodes.shape[1] - 3), min(max(int(y), 1), nodes.shape[0] - 3)
    f, v = x - i, y - j
    wx = (-f * (f - 1) * (f - 2) / 6, (f + 1) * (f - 1) * (f - 2) / 2, -(f + 1) * f * (f - 2) / 2, (f + 1) * f * (f - 1) / 6)
    wy = (-v * (v - 1) * (v - 2) / 6, (v + 1) * (v - 1) * (v - 2) / 2, -(v + 1) * v * (v - 2) / 2, (v + 1) * v * (v - 1) / 6)
    a, b = 0.0, 0.0
    for q in range(4):
        for p in range(4):
            w = wy[q] * wx[p]
            a += w * nodes[j + q - 1, i + p - 1, 0]
            b += w * nodes[j + q - 1, i + p - 1, 1]
    return a, b


@kernel
def polynomials(nodes: np.ndarray, centres: np.ndarray, out: np.ndarray) -> None:
    """out (m, 2, 10): cubics from local pixel to local ideal coordinates around centres (m, 3) x, y, scale px.

    Local pixel: (pixel - centre) / scale. Local ideal: (ideal * focal - its value at the centre) / scale. nodes : `table`
    """
    for m in range(len(centres)):
        cx, cy, scale = centres[m, 0], centres[m, 1], centres[m, 2]
        a0, b0 = _at(nodes, cx, cy)
        out[m] = 0
        for k in range(len(_NODES)):
            a, b = _at(nodes, cx + scale * _NODES[k, 0], cy + scale * _NODES[k, 1])
            for i in range(10):
                out[m, 0, i] += _TO_POLYNOMIAL[i, k] * (a - a0) / scale
                out[m, 1, i] += _TO_POLYNOMIAL[i, k] * (b - b0) / scale


@kernel
def to_ideal(lens: np.ndarray, u: float, v: float) -> tuple[float, float]:
    """Local ideal coordinates of local pixel coordinates by the cubic polynomials of a lens (2, 10)."""
    x = lens[0, 0] + u * (lens[0, 1] + u * (lens[0, 3] + u * lens[0, 6])) + v * (
        lens[0, 2] + u * (lens[0, 4] + u * lens[0, 7]) + v * (lens[0, 5] + u * lens[0, 8] + v * lens[0, 9]))
    y = lens[1, 0] + u * (lens[1, 1] + u * (lens[1, 3] + u * lens[1, 6])) + v * (
        lens[1, 2] + u * (lens[1, 4] + u * lens[1, 7]) + v * (lens[1, 5] + u * lens[1, 8] + v * lens[1, 9]))
    return x, y


class LocalPixel(NamedTuple):
    """Local pixel coordinates u, v, and how they change with local ideal coordinates x, y: ux = du/dx and so on."""

    u: float
    v: float
    ux: float
    uy: float
    vx: float
    vy: float


@kernel
def to_pixel(lens: np.ndarray, x: float, y: float, u: float, v: float) -> LocalPixel:
    """LocalPixel that `to_ideal` sends to x, y by a lens (2, 10), from a guess u, v."""
    ux, uy, vx, vy = 1.0, 0.0, 0.0, 1.0
    for _ in range(4):
        a, b = to_ideal(lens, u, v)
        xu = lens[0, 1] + u * (2 * lens[0, 3] + 3 * u * lens[0, 6] + 2 * v * lens[0, 7]) + v * (lens[0, 4] + v * lens[0, 8])
        xv = lens[0, 2] + v * (2 * lens[0, 5] + 3 * v * lens[0, 9] + 2 * u * lens[0, 8]) + u * (lens[0, 4] + u * lens[0, 7])
        yu = lens[1, 1] + u * (2 * lens[1, 3] + 3 * u * lens[1, 6] + 2 * v * lens[1, 7]) + v * (lens[1, 4] + v * lens[1, 8])
        yv = lens[1, 2] + v * (2 * lens[1, 5] + 3 * v * lens[1, 9] + 2 * u * lens[1, 8]) + u * (lens[1, 4] + u * lens[1, 7])
        det = xu * yv - xv * yu
        ux, uy, vx, vy = yv / det, -xv / det, -yu / det, xu / det
        u += ux * (x - a) + uy * (y - b)
        v += vx * (x - a) + vy * (y - b)
    return LocalPixel(u, v, ux, uy, vx, vy)


@kernel
def to_image(lens: np.ndarray, centre: np.ndarray, guess: np.ndarray, corners: np.ndarray, covariance: np.ndarray) -> None:
    """Corners (4, 2), in place, and their covariance (8, 8) from local ideal coordinates to px; guess : (4, 2) px."""
    D = np.zeros((8, 8))
    for c in range(4):
        u, v = (guess[c, 0] - centre[0]) / centre[2], (guess[c, 1] - centre[1]) / centre[2]
        u, v, ux, uy, vx, vy = to_pixel(lens, corners[c, 0], corners[c, 1], u, v)
        corners[c, 0], corners[c, 1] = u * centre[2] + centre[0], v * centre[2] + centre[1]
        D[2 * c, 2 * c], D[2 * c, 2 * c + 1], D[2 * c + 1, 2 * c], D[2 * c + 1, 2 * c + 1] = ux, uy, vx, vy
    half = np.zeros((8, 8))
    for a in range(8):
        for b in range(8):
            c = 2 * (a // 2)
            half[a, b] = centre[2] * (D[a, c] * covariance[c, b] + D[a, c + 1] * covariance[c + 1, b])
    for a in range(8):
        for b in range(8):
            c = 2 * (b // 2)
            covariance[a, b] = centre[2] * (half[a, c] * D[b, c] + half[a, c + 1] * D[b, c + 1])
