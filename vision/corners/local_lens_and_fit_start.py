"""Local lens near a marker, and the start of a square fit.

The local lens is a polynomial from pixels to ideal image coordinates, of fourth degree: a lens's fifth leaves cubic
ones off by 0.0005 px over a marker of 120 px, the same in every image where it stands there. A fit starts with a
square's sides, from profiles across them, and with a check of its bits.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats, Pixels
from rig.model.design import Camera
from vision import opencv_lens_model as lens
from vision.corners.blurred_edge_image_model_and_numba_kernels import inlined_kernel, kernel, order_statistic

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
def fill_local_lens_polynomials(nodes: Floats, centres: Floats, out: Floats) -> None:
    """Fill `out` (m, 2, TERMS) with local polynomials from pixel to ideal coordinates around centres (m, 3).

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
def local_pixel_to_local_ideal(lens: Floats, u: float, v: float) -> tuple[float, float]:
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
def local_ideal_to_local_pixel_and_derivatives(lens: Floats, x: float, y: float, u: float, v: float) -> LocalPixel:
    """Local pixel of local ideal coordinates x, y, and derivatives.

    It is by a lens (2, TERMS), from a guess u, v.
    Inverse of local_pixel_to_local_ideal.
    """
    ux, uy, vx, vy = 1.0, 0.0, 0.0, 1.0
    for _ in range(4):
        a, b = local_pixel_to_local_ideal(lens, u, v)
        (xu, xv), (yu, yv) = _change(lens[0], u, v), _change(lens[1], u, v)
        det = xu * yv - xv * yu
        ux, uy, vx, vy = yv / det, -xv / det, -yu / det, xu / det
        u += ux * (x - a) + uy * (y - b)
        v += vx * (x - a) + vy * (y - b)
    return LocalPixel(u, v, ux, uy, vx, vy)


@kernel
def convert_corners_and_covariance_to_pixels_in_place(
    lens: Floats, centre: Floats, guess: Floats, corners: Floats, covariance: Floats
) -> None:
    """Convert corners (4, 2) and covariance (8, 8) from local ideal coordinates to image px, in place.

    guess : (4, 2) px
    """
    D = np.zeros((8, 8))
    for c in range(4):
        u, v = (guess[c, 0] - centre[0]) / centre[2], (guess[c, 1] - centre[1]) / centre[2]
        u, v, ux, uy, vx, vy = local_ideal_to_local_pixel_and_derivatives(lens, corners[c, 0], corners[c, 1], u, v)
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


PROFILES = 8  # along each side
FAINTEST = 6.0  # grey levels; a step below this is none


@kernel
def copy_image_boxes(image: Pixels, boxes: Floats, starts: Floats, out: Floats) -> None:
    """Copy the boxes (m, 4) of an image into flat float32 out.

    One after the other from starts (m,).
    """
    for m in range(len(boxes)):
        k, x0, width = np.uintp(starts[m]), np.uintp(boxes[m, 0]), np.uintp(boxes[m, 2] - boxes[m, 0])
        for y in range(boxes[m, 1], boxes[m, 3]):
            row = image[y]
            for x in range(width):  # unsigned, so that many pixels are copied at once
                out[k + x] = row[x0 + x]
            k += width


@kernel
def _between(crop: Floats, x: float, y: float) -> float:
    """Grey level between pixels, held at the border."""
    x = min(max(x, 0.0), crop.shape[1] - 1.001)
    y = min(max(y, 0.0), crop.shape[0] - 1.001)
    i, j = int(x), int(y)
    f, v = x - i, y - j
    return (1 - v) * ((1 - f) * crop[j, i] + f * crop[j, i + 1]) + v * (
        (1 - f) * crop[j + 1, i] + f * crop[j + 1, i + 1]
    )


@inlined_kernel
def _black_and_white(crop: Floats, box: Floats, quad: Floats) -> tuple[float, float]:
    """Grey levels of a marker's own black and white, of places all over a quad (4, 2) px."""
    inside = np.empty(64)
    for k in range(64):
        s, t = (k % 8 + 0.5) / 8, (k // 8 + 0.5) / 8
        x = (1 - t) * ((1 - s) * quad[0, 0] + s * quad[1, 0]) + t * ((1 - s) * quad[3, 0] + s * quad[2, 0]) - box[0]
        y = (1 - t) * ((1 - s) * quad[0, 1] + s * quad[1, 1]) + t * ((1 - s) * quad[3, 1] + s * quad[2, 1]) - box[1]
        inside[k] = _between(crop, x, y)
    return order_statistic(inside, 5), order_statistic(inside, 58)


@inlined_kernel
def _line(where: Floats, offsets: Floats, found: int) -> tuple[float, float]:
    """(shift, turn) px of a side by the line through the offsets (PROFILES,) of the first `found` profiles, at where
    (PROFILES,) along it; those that stand apart do not count, and of fewer than half the profiles there is none."""
    shift, turn = 0.0, 0.0
    if found < PROFILES // 2:
        return shift, turn
    centre = order_statistic(offsets[:found], found // 2)
    for tries in range(2):  # the second time without those that stand apart
        n, st, stt, so, sot = 0, 0.0, 0.0, 0.0, 0.0
        for q in range(found):
            if abs(offsets[q] - centre - turn * where[q]) < (2.0 if tries == 0 else 0.6):
                n += 1
                st += where[q]
                stt += where[q] * where[q]
                so += offsets[q]
                sot += where[q] * offsets[q]
        det = n * stt - st * st
        if n < PROFILES // 3 or det < 1e-3:
            break
        turn = (n * sot - st * so) / det
        centre = (so - turn * st) / n
        shift = centre
    return shift, turn


@kernel
def fit_quad_sides_in_place(crop: Floats, box: Floats, quad: Floats, size: int, search_distance: float) -> None:
    """Fit the sides of a quad (4, 2) px, in place, to the dark-to-bright steps in profiles across them.

    A side is moved by a line through the steps found within reach (px) and within the border of black, one of `size`
    cells; it stays where fewer than half its profiles show one.
    """
    lines = np.empty((4, 3))  # nx x + ny y = d
    where, offsets = np.empty(PROFILES), np.empty(PROFILES)
    profile = np.empty(2 * int(math.ceil(search_distance)) + 1)
    dark, bright = _black_and_white(crop, box, quad)
    if bright - dark < FAINTEST:
        return
    middle = 0.5 * (bright + dark)  # of this marker's own black and white: a brighter face beside it has others
    for k in range(4):
        ax, ay = quad[k, 0] - box[0], quad[k, 1] - box[1]
        ex, ey = quad[(k + 1) % 4, 0] - box[0] - ax, quad[(k + 1) % 4, 1] - box[1] - ay
        length = max(math.sqrt(ex * ex + ey * ey), 1e-6)
        nx, ny = ey / length, -ex / length
        across = 0.0
        for q in range(2, 4):
            across -= 0.5 * ((quad[(k + q) % 4, 0] - quad[k, 0]) * nx + (quad[(k + q) % 4, 1] - quad[k, 1]) * ny)
        near = min(search_distance, 0.9 * max(across, 1.0) / size)
        steps, found = int(math.ceil(near)), 0
        for q in range(PROFILES):
            t = 0.06 + 0.88 * (q + 0.5) / PROFILES
            for d in range(-steps, steps + 1):
                profile[d + steps] = _between(crop, ax + t * ex + d * nx, ay + t * ey + d * ny)
            nearest = 1e9
            for d in range(2 * steps):
                if profile[d] < middle <= profile[d + 1]:
                    at = d - steps + (middle - profile[d]) / (profile[d + 1] - profile[d])
                    if abs(at) < abs(nearest):
                        nearest = at
            if abs(nearest) <= near:
                where[found], offsets[found] = t - 0.5, nearest
                found += 1
        shift, turn = _line(where, offsets, found)
        px, py = ax + 0.5 * ex + shift * nx, ay + 0.5 * ey + shift * ny
        dx, dy = ex + turn * nx, ey + turn * ny
        lines[k, 0], lines[k, 1], lines[k, 2] = dy, -dx, dy * px - dx * py
    for k in range(4):
        a, b = lines[(k + 3) % 4], lines[k]
        det = a[0] * b[1] - a[1] * b[0]
        if abs(det) > 1e-6:
            quad[k, 0] = (a[2] * b[1] - a[1] * b[2]) / det + box[0]
            quad[k, 1] = (a[0] * b[2] - a[2] * b[0]) / det + box[1]


@kernel
def fill_square_homography(quad: Floats, lens: Floats, centre: Floats, bit_count: int, homography: Floats) -> bool:
    """Fill `homography` (3, 3) from local ideal coordinates to cells of a square with corners quad (4, 2) px.

    bit_count : of the square each way. False where the corners do not turn clockwise around a convex figure. Source:
    Heckbert 1989, square to quadrilateral
    """
    px, py = np.empty(4), np.empty(4)
    for c in range(4):
        px[c], py[c] = local_pixel_to_local_ideal(
            lens, (quad[c, 0] - centre[0]) / centre[2], (quad[c, 1] - centre[1]) / centre[2]
        )
    for c in range(4):
        a, b = (c + 1) % 4, (c + 2) % 4
        if not (px[a] - px[c]) * (py[b] - py[a]) - (py[a] - py[c]) * (px[b] - px[a]) > 1e-6:
            return False
    sx, sy = px[0] - px[1] + px[2] - px[3], py[0] - py[1] + py[2] - py[3]
    dx1, dx2, dy1, dy2 = px[1] - px[2], px[3] - px[2], py[1] - py[2], py[3] - py[2]
    det = dx1 * dy2 - dx2 * dy1
    p, q = (sx * dy2 - dx2 * sy) / det, (dx1 * sy - sx * dy1) / det
    a, b, c = px[1] - px[0] + p * px[1], px[3] - px[0] + q * px[3], px[0]
    d, e, f = py[1] - py[0] + p * py[1], py[3] - py[0] + q * py[3], py[0]
    inverse = (
        (e - f * q, c * q - b, b * f - c * e),
        (f * p - d, a - c * p, c * d - a * f),
        (d * q - e * p, b * p - a * q, a * e - b * d),
    )
    size = bit_count + 2.0
    last = inverse[2][2]
    for k in range(3):
        homography[0, k] = (size * inverse[0][k] - inverse[2][k]) / last
        homography[1, k] = (size * inverse[1][k] - inverse[2][k]) / last
        homography[2, k] = inverse[2][k] / last
    return True


@kernel
def misread_cell_count(crop: Floats, box: Floats, quad: Floats, cells: Floats) -> int:
    """Count of a marker's misread cells in a quad (4, 2) px.

    The black border is included.
    All of them where white is no brighter than black. Five points of each cell are read.
    """
    size = cells.shape[0] - 2
    px, py = quad[:, 0] - box[0], quad[:, 1] - box[1]
    sx, sy = px[0] - px[1] + px[2] - px[3], py[0] - py[1] + py[2] - py[3]
    dx1, dx2, dy1, dy2 = px[1] - px[2], px[3] - px[2], py[1] - py[2], py[3] - py[2]
    det = dx1 * dy2 - dx2 * dy1
    if not abs(det) > 1e-6:
        return size * size
    p, q = (sx * dy2 - dx2 * sy) / det, (dx1 * sy - sx * dy1) / det
    read = np.empty((size, size))
    total, count = np.zeros(2), np.zeros(2)
    for j in range(size):
        for i in range(size):
            read[j, i] = 0
            for k in range(5):
                s, t = (
                    (i + 0.5 + (0.2, -0.2, 0.0, 0.0, 0.0)[k]) / size,
                    (j + 0.5 + (0.0, 0.0, 0.0, 0.2, -0.2)[k]) / size,
                )
                w = 1 + p * s + q * t
                x = ((px[1] - px[0] + p * px[1]) * s + (px[3] - px[0] + q * px[3]) * t + px[0]) / w
                y = ((py[1] - py[0] + p * py[1]) * s + (py[3] - py[0] + q * py[3]) * t + py[0]) / w
                read[j, i] += _between(crop, x, y) / 5
            white = 1 if cells[j + 1, i + 1] > 0.5 else 0
            total[white] += read[j, i]
            count[white] += 1
    black, white = total[0] / max(count[0], 1.0), total[1] / max(count[1], 1.0)
    if not white - black > FAINTEST:
        return size * size
    wrong = 0
    for j in range(size):
        for i in range(size):
            wrong += (read[j, i] > (black + white) / 2) != (cells[j + 1, i + 1] > 0.5)
    return wrong
