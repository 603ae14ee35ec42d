"""Local lens near one marker.

Polynomials from pixels to ideal image coordinates.

They are of fourth degree: a lens's fifth leaves cubic ones off by 0.0005 px over a marker of 120 px, the same in every
image where it stands there.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats
from rig.model.design import Camera
from vision import lens
from vision.corners.numba_cholesky_and_order_statistics import kernel

SPACING = 32.0  # px between the table's nodes; four of them to each side interpolate a lens of photographs to 1e-5 px
BEYOND = 4  # nodes outside the image
_SPREAD = 1.2  # half widths of a marker over which its polynomials hold
_ORDERS = np.array([[degree - k, k] for degree in range(5) for k in range(degree + 1)])
TERMS = len(_ORDERS)  # of a polynomial: 1, u, v, u^2, u v, v^2, u^3 ..
_NODES = _SPREAD * np.stack(np.meshgrid(*[np.cos(np.pi * (np.arange(5) + 0.5) / 5)] * 2), axis=-1).reshape(-1, 2)
_TO_POLYNOMIAL = np.linalg.pinv((_NODES[:, None, :] ** _ORDERS).prod(axis=2))


def local_coordinate_origins_and_scales(quads: Floats) -> Floats:
    """Origins x, y and scale (m, 3) px of the local coordinates of markers with corners (m, 4, 2) px."""
    middle = quads.mean(axis=1)
    return np.concatenate([middle, np.abs(quads - middle[:, None]).max(axis=(1, 2))[:, None]], axis=1)


def ideal_coordinate_table(camera: Camera) -> Floats:
    """Table (rows, columns, 2) of ideal coordinates at nodes SPACING px apart.

    Times the focal lengths.

    From -BEYOND * SPACING on; NaN beyond a lens.
    """
    return _table(camera.matrix.tobytes(), np.asarray(camera.distortion, float).tobytes(), camera.width, camera.height)


@lru_cache(maxsize=64)
def _table(matrix: bytes, distortion: bytes, width: int, height: int) -> Floats:
    K = np.frombuffer(matrix).reshape(3, 3)
    u, v = (SPACING * np.arange(-BEYOND, int(size / SPACING) + BEYOND + 2) for size in (width, height))
    ideal = lens.undistort(np.stack(np.meshgrid(u, v), axis=-1), K, np.frombuffer(distortion))
    return ideal * K[[0, 1], [0, 1]]


@kernel
def _at(nodes: Floats, x: float, y: float) -> tuple[float, float]:
    """The table's value at pixel x, y: cubic through four nodes each way (Lagrange)."""
    x, y = x / SPACING + BEYOND, y / SPACING + BEYOND
    i, j = min(max(int(x), 1), nodes.shape[1] - 3), min(max(int(y), 1), nodes.shape[0] - 3)
    f, v = x - i, y - j
    wx = (
        -f * (f - 1) * (f - 2) / 6,
        (f + 1) * (f - 1) * (f - 2) / 2,
        -(f + 1) * f * (f - 2) / 2,
        (f + 1) * f * (f - 1) / 6,
    )
    wy = (
        -v * (v - 1) * (v - 2) / 6,
        (v + 1) * (v - 1) * (v - 2) / 2,
        -(v + 1) * v * (v - 2) / 2,
        (v + 1) * v * (v - 1) / 6,
    )
    a, b = 0.0, 0.0
    for q in range(4):
        for p in range(4):
            w = wy[q] * wx[p]
            a += w * nodes[j + q - 1, i + p - 1, 0]
            b += w * nodes[j + q - 1, i + p - 1, 1]
    return a, b


@kernel
def fit_local_polynomials(nodes: Floats, centres: Floats, out: Floats) -> None:
    """Fit local polynomials out (m, 2, TERMS).

    Pixel to ideal coordinates, around centres (m, 3).

    Local pixel: (pixel - centre) / scale. Local ideal: (ideal * focal - its value at the centre) / scale.
    nodes : `ideal_coordinate_table`
    """
    for m in range(len(centres)):
        cx, cy, scale = centres[m, 0], centres[m, 1], centres[m, 2]
        a0, b0 = _at(nodes, cx, cy)
        out[m] = 0
        for k in range(len(_NODES)):
            a, b = _at(nodes, cx + scale * _NODES[k, 0], cy + scale * _NODES[k, 1])
            for i in range(TERMS):
                out[m, 0, i] += _TO_POLYNOMIAL[i, k] * (a - a0) / scale
                out[m, 1, i] += _TO_POLYNOMIAL[i, k] * (b - b0) / scale


class Along(NamedTuple):
    """A polynomial along a row of pixels, in powers of u: a + b u + c u^2 + d u^3 + e u^4."""

    a: float
    b: float
    c: float
    d: float
    e: float


@kernel
def polynomial_along_row(terms: Floats, v: float) -> Along:
    """A polynomial (TERMS,) of u, v as a polynomial of u along the row v."""
    a = terms[0] + v * (terms[2] + v * (terms[5] + v * (terms[9] + v * terms[14])))
    b = terms[1] + v * (terms[4] + v * (terms[8] + v * terms[13]))
    return Along(a, b, terms[3] + v * (terms[7] + v * terms[12]), terms[6] + v * terms[11], terms[10])


@kernel
def _change(terms: Floats, u: float, v: float) -> tuple[float, float]:
    """How a polynomial (TERMS,) changes with u and with v."""
    p = polynomial_along_row(terms, v)
    with_v = (
        terms[2]
        + v * (2 * terms[5] + v * (3 * terms[9] + 4 * v * terms[14]))
        + u * (terms[4] + v * (2 * terms[8] + 3 * v * terms[13]) + u * (terms[7] + 2 * v * terms[12] + u * terms[11]))
    )
    return p.b + u * (2 * p.c + u * (3 * p.d + 4 * u * p.e)), with_v


@kernel
def pixel_to_ideal(lens: Floats, u: float, v: float) -> tuple[float, float]:
    """Local ideal coordinates of local pixel coordinates by the polynomials of a lens (2, TERMS)."""
    x, y = polynomial_along_row(lens[0], v), polynomial_along_row(lens[1], v)
    return x.a + u * (x.b + u * (x.c + u * (x.d + u * x.e))), y.a + u * (y.b + u * (y.c + u * (y.d + u * y.e)))


class LocalPixel(NamedTuple):
    """Local pixel coordinates u, v, and how they change with local ideal coordinates x, y: ux = du/dx and so on."""

    u: float
    v: float
    ux: float
    uy: float
    vx: float
    vy: float


@kernel
def ideal_to_pixel(lens: Floats, x: float, y: float, u: float, v: float) -> LocalPixel:
    """Local pixel of ideal coordinates x, y by a lens (2, TERMS), from a guess u, v.

    Inverse of pixel_to_ideal.
    """
    ux, uy, vx, vy = 1.0, 0.0, 0.0, 1.0
    for _ in range(4):
        a, b = pixel_to_ideal(lens, u, v)
        (xu, xv), (yu, yv) = _change(lens[0], u, v), _change(lens[1], u, v)
        det = xu * yv - xv * yu
        ux, uy, vx, vy = yv / det, -xv / det, -yu / det, xu / det
        u += ux * (x - a) + uy * (y - b)
        v += vx * (x - a) + vy * (y - b)
    return LocalPixel(u, v, ux, uy, vx, vy)


@kernel
def corners_to_image(lens: Floats, centre: Floats, guess: Floats, corners: Floats, covariance: Floats) -> None:
    """Convert corners (4, 2) and covariance (8, 8) from local ideal coordinates to image px, in place.

    guess : (4, 2) px
    """
    D = np.zeros((8, 8))
    for c in range(4):
        u, v = (guess[c, 0] - centre[0]) / centre[2], (guess[c, 1] - centre[1]) / centre[2]
        u, v, ux, uy, vx, vy = ideal_to_pixel(lens, corners[c, 0], corners[c, 1], u, v)
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
