"""Where a square's edges are, to begin with: its sides found in profiles, and the pixels near its edges collected for the fit."""

import math

import numpy as np

from vision.corners.jit import kernel
from vision.corners.local_lens import to_ideal

REACH = 3.6  # edge widths on either side of an edge that are looked at; with vision/corners/spread.py's KNOTS by the rule in tests/bench/reach.py:
# of reaches 2.4, 2.8, 3.2, 3.6 and 5, 7, 9, 11 knots the smallest within 1 % of the least corner error on exact and rendered pictures
CLEAR = 3.2  # edge widths kept clear of whatever lies beyond the white margin
PROFILES = 8  # along each side
FAINTEST = 6.0  # grey levels; a step below this is none


@kernel
def cut(image, boxes, starts, out):
    """Copy the boxes (m, 4) x0 y0 x1 y1 of an image one after the other into out, flat float32, from starts (m,)."""
    for m in range(len(boxes)):
        k = starts[m]
        for y in range(boxes[m, 1], boxes[m, 3]):
            for x in range(boxes[m, 0], boxes[m, 2]):
                out[k] = image[y, x]
                k += 1


@kernel
def _between(crop, x, y):
    """Grey level between pixels, held at the border."""
    x = min(max(x, 0.0), crop.shape[1] - 1.001)
    y = min(max(y, 0.0), crop.shape[0] - 1.001)
    i, j = int(x), int(y)
    f, v = x - i, y - j
    return (1 - v) * ((1 - f) * crop[j, i] + f * crop[j, i + 1]) + v * ((1 - f) * crop[j + 1, i] + f * crop[j + 1, i + 1])


@kernel
def straighten(crop, box, quad, size, reach):
    """Move the sides of a quad (4, 2) px, in place, onto the steps from dark inside to bright outside that profiles across them show.

    A side is moved by a line through the steps found within reach (px) and within the border of black, one of `size` cells; it stays
    where fewer than half its profiles show one.
    """
    lines = np.empty((4, 3))  # nx x + ny y = d
    where, offsets = np.empty(PROFILES), np.empty(PROFILES)
    profile, inside = np.empty(2 * int(math.ceil(reach)) + 1), np.empty(64)
    for k in range(64):
        s, t = (k % 8 + 0.5) / 8, (k // 8 + 0.5) / 8
        x = (1 - t) * ((1 - s) * quad[0, 0] + s * quad[1, 0]) + t * ((1 - s) * quad[3, 0] + s * quad[2, 0]) - box[0]
        y = (1 - t) * ((1 - s) * quad[0, 1] + s * quad[1, 1]) + t * ((1 - s) * quad[3, 1] + s * quad[2, 1]) - box[1]
        inside[k] = _between(crop, x, y)
    inside.sort()
    if inside[58] - inside[5] < FAINTEST:
        return
    middle = 0.5 * (inside[58] + inside[5])  # of this marker's own black and white: a brighter face beside it has others
    for k in range(4):
        ax, ay = quad[k, 0] - box[0], quad[k, 1] - box[1]
        ex, ey = quad[(k + 1) % 4, 0] - box[0] - ax, quad[(k + 1) % 4, 1] - box[1] - ay
        length = max(math.sqrt(ex * ex + ey * ey), 1e-6)
        nx, ny = ey / length, -ex / length
        across = 0.0
        for q in range(2, 4):
            across -= 0.5 * ((quad[(k + q) % 4, 0] - quad[k, 0]) * nx + (quad[(k + q) % 4, 1] - quad[k, 1]) * ny)
        near = min(reach, 0.9 * max(across, 1.0) / size)
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
        shift, turn = 0.0, 0.0
        if found >= PROFILES // 2:
            centre = np.median(offsets[:found])
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
def homography(quad, lens, centre, n, g):
    """g (3, 3), last entry 1: local ideal coordinates to cells, for a square of n + 2 cells whose corners are quad (4, 2) px.

    False where the corners do not turn clockwise around a convex figure. Source: Heckbert 1989, square to quadrilateral
    """
    px, py = np.empty(4), np.empty(4)
    for c in range(4):
        px[c], py[c] = to_ideal(lens, (quad[c, 0] - centre[0]) / centre[2], (quad[c, 1] - centre[1]) / centre[2])
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
    inverse = ((e - f * q, c * q - b, b * f - c * e), (f * p - d, a - c * p, c * d - a * f), (d * q - e * p, b * p - a * q, a * e - b * d))
    size = n + 2.0
    last = inverse[2][2]
    for k in range(3):
        g[0, k] = (size * inverse[0][k] - inverse[2][k]) / last
        g[1, k] = (size * inverse[1][k] - inverse[2][k]) / last
        g[2, k] = inverse[2][k] / last
    return True


@kernel
def misread(crop, box, quad, cells):
    """How many of a marker's cells, its black border among them, have not the colour that they ought to; quad (4, 2) px.

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
                s, t = (i + 0.5 + (0.2, -0.2, 0.0, 0.0, 0.0)[k]) / size, (j + 0.5 + (0.0, 0.0, 0.0, 0.2, -0.2)[k]) / size
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


NOTHING, SEVERAL = 0, 1  # then one edge: 2 + 4 axis + 2 far side + white first


def outlook(cells):
    """(k, k, 16) int8 of cells (k, k): what a pixel of each cell sees, by which of its sides (1 left, 2 right, 4 top, 8 bottom) are in reach.

    NOTHING, SEVERAL edges, or one: 2 + 4 where it lies across (Y) + 2 where it is the right or lower side + 1 where white comes first
    """
    k = len(cells)
    at = np.arange(k)
    out = np.zeros((k, k, 16), np.int8)
    for sides in range(16):
        x = [np.maximum(at - (sides & 1 > 0), 0), at, np.minimum(at + (sides & 2 > 0), k - 1)]
        y = [np.maximum(at - (sides & 4 > 0), 0), at, np.minimum(at + (sides & 8 > 0), k - 1)]
        seen = np.array([[cells[np.ix_(v, u)] for u in x] for v in y])  # (3, 3, k, k)
        rows_alike, columns_alike = (seen == seen[1:2]).all(axis=(0, 1)), (seen == seen[:, 1:2]).all(axis=(0, 1))
        out[..., sides] = SEVERAL
        for axis, alike, low, high in ((0, rows_alike, seen[1, 0], seen[1, 2]), (1, columns_alike, seen[0, 1], seen[2, 1])):
            one = alike & ((low == cells) != (high == cells))
            far = low == cells
            out[..., sides] = np.where(one, 2 + 4 * axis + 2 * far + (far == (cells == 1)), out[..., sides])
        out[rows_alike & columns_alike, sides] = NOTHING
    return out


@kernel
def _row(quad, pad, y, low, high):
    """Pixels [low, high) of image row y that lie in a convex quad (4, 2) px widened by pad."""
    first, last = low - 1.0, high + 1.0
    for k in range(4):
        ex, ey = quad[(k + 1) % 4, 0] - quad[k, 0], quad[(k + 1) % 4, 1] - quad[k, 1]
        room = pad * math.sqrt(ex * ex + ey * ey) + ey * quad[k, 0] - ex * (quad[k, 1] - y)  # ey x <= room inside
        if ey > 1e-9:
            last = min(last, room / ey)
        elif ey < -1e-9:
            first = max(first, room / ey)
        elif room < 0:
            return 0, 0
    return max(low, int(math.ceil(first))), min(high, int(math.floor(last)) + 1)


@kernel
def edge_pixels(crop, box, quad, lens, centre, seen, n, margin, g, s, points, greys, places):
    """Collect the pixels near an edge; returns how many.

    quad : (4, 2) px, the corners; seen : `outlook` of the cells; points : (k, 2) out, local ideal coordinates; greys : (k,) out
    places : (k, 3) out: kind, i, j. Kind +-1: one edge X = i, white on its right (+) or left (-); +-2: one edge Y = j, white
    below (+) or above (-); 0: several edges around cell i, j
    """
    cx, cy, scale = centre
    count, row = 0, np.empty((5, crop.shape[1]))
    # cells to the pixel in the middle of the marker; perspective changes them with w, and w is followed
    Xx, Xy = g[0, 0] - 0.5 * n * g[2, 0], g[0, 1] - 0.5 * n * g[2, 1]
    Yx, Yy = g[1, 0] - 0.5 * n * g[2, 0], g[1, 1] - 0.5 * n * g[2, 1]
    reach_x = REACH * s * math.sqrt((Xx * lens[0, 1] + Xy * lens[1, 1]) ** 2 + (Xx * lens[0, 2] + Xy * lens[1, 2]) ** 2) / scale
    reach_y = REACH * s * math.sqrt((Yx * lens[0, 1] + Yy * lens[1, 1]) ** 2 + (Yx * lens[0, 2] + Yy * lens[1, 2]) ** 2) / scale
    g00, g01, g02, g10, g11, g12, g20, g21 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1]
    pad = REACH * s + 1 + 0.02 * scale  # a lens bends the sides
    for y in range(box[1], box[3]):
        v = (y - cy) / scale
        a0, b0 = lens[0, 0] + v * (lens[0, 2] + v * (lens[0, 5] + v * lens[0, 9])), lens[1, 0] + v * (lens[1, 2] + v * (lens[1, 5] + v * lens[1, 9]))
        a1, b1 = lens[0, 1] + v * (lens[0, 4] + v * lens[0, 8]), lens[1, 1] + v * (lens[1, 4] + v * lens[1, 8])
        a2, b2, a3, b3 = lens[0, 3] + v * lens[0, 7], lens[1, 3] + v * lens[1, 7], lens[0, 6], lens[1, 6]
        start, end = _row(quad, pad, y, box[0], box[2])
        for k in range(end - start):
            u = (start + k - cx) / scale
            xi, yi = a0 + u * (a1 + u * (a2 + u * a3)), b0 + u * (b1 + u * (b2 + u * b3))
            w = 1 / (g20 * xi + g21 * yi + 1)
            row[0, k], row[1, k], row[2, k] = xi, yi, w
            row[3, k], row[4, k] = (g00 * xi + g01 * yi + g02) * w, (g10 * xi + g11 * yi + g12) * w
        for k in range(end - start):
            w, X, Y = row[2, k], row[3, k], row[4, k]
            rx, ry = reach_x * w, reach_y * w
            X0, Y0 = min(max(X, -2.0), n + 1.9), min(max(Y, -2.0), n + 1.9)  # cells that stand for all beyond
            i, j = int(X0 + 2) - 2, int(Y0 + 2) - 2
            fx, fy = X0 - i, Y0 - j
            sides = (fx < rx) + 2 * (1 - fx < rx) + 4 * (fy < ry) + 8 * (1 - fy < ry)
            far = max(rx, ry)
            code = seen[j + 2, i + 2, sides] if far < 1 else SEVERAL  # where cells beyond the next are in sight nobody has looked
            outside = max(max(-1 - X, X - (n + 1)), max(-1 - Y, Y - (n + 1)))
            single = code - 2
            kind = (0 if single < 0 else (1 if single < 4 else 2)) * (-1 if single & 1 else 1)
            second = single >= 0 and single & 2 != 0
            points[count, 0], points[count, 1] = row[0, k], row[1, k]
            greys[count] = crop[y - box[1], start + k - box[0]]
            places[count, 0] = kind
            places[count, 1] = i + (second and single < 4)
            places[count, 2] = j + (second and single >= 4)
            # written first and kept after, because a processor cannot guess which pixels are
            count += (code != 0) & (w > 0) & (outside < min(far, margin - CLEAR / REACH * far))
    return count
