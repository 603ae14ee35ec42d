"""Start of a square fit, and bit check.

Its sides, from profiles across them, and a check of its bits.
"""

import math

import numpy as np

from rig.array_and_json_types import Floats, Pixels
from vision.corners.local_lens import pixel_to_ideal
from vision.corners.numba_cholesky_and_order_statistics import inlined_kernel, kernel, order_statistic

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
def square_homography(quad: Floats, lens: Floats, centre: Floats, n: int, g: Floats) -> bool:
    """Homography g (3, 3) from local ideal coordinates to cells of a square with corners quad (4, 2) px.

    False where the corners do not turn clockwise around a convex figure. Source: Heckbert 1989, square to quadrilateral
    """
    px, py = np.empty(4), np.empty(4)
    for c in range(4):
        px[c], py[c] = pixel_to_ideal(lens, (quad[c, 0] - centre[0]) / centre[2], (quad[c, 1] - centre[1]) / centre[2])
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
    size = n + 2.0
    last = inverse[2][2]
    for k in range(3):
        g[0, k] = (size * inverse[0][k] - inverse[2][k]) / last
        g[1, k] = (size * inverse[1][k] - inverse[2][k]) / last
        g[2, k] = inverse[2][k] / last
    return True


@kernel
def misread_cell_count(crop: Floats, box: Floats, quad: Floats, cells: Floats) -> int:
    """Count of a marker's misread cells, black border included, in a quad (4, 2) px.

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
