"""The image of one printed square: a known pattern of cells, seen through a homography, a lens, blur and a pixel grid.

The whole marker is fitted at once (Gauss-Newton on the pixels near its edges): the homography from image to cells (8
unknowns), the width of the edges (1), and the grey of black and of white, each a plane over the image (6). How brightness
climbs across an edge is a tabulated edge spread function, the pixel's own width included: a Gaussian's, or one learnt from
the images (vision/corners/spread.py), one for each direction of edges. Where two edges meet, their product is corrected by a
bivariate normal's correlated part (vision/corners/pattern.py), because a marker's axes are seldom square in the image.
Source: corner accuracy from edges, Rohr 1992; dense alignment of a marker, Wu et al., DodecaPen, UIST 2017
"""

import math

import numpy as np

from vision.corners.cholesky import factor, solve
from vision.corners.edges import REACH, edge_pixels, homography, misread, straighten
from vision.corners.jit import kernel
from vision.corners.local_lens import to_image
from vision.corners.misfit import misfit, profile_left, segments
from vision.corners.pattern import edge, pattern, wide_pattern

UNKNOWNS = 15
ROWS = 16  # the unknowns and the residual: one row each of what is multiplied out
CHUNK = 256  # pixels multiplied out at a time; their rows fit the processor's first cache
SAMPLE = 300  # pixels that take part while the fit is still on its way
TRUSTED = 5.0  # robust standard deviations; a pixel farther off counts less, and soon nothing: something covers it
SATURATED = 254.5  # 255ths of white; a brighter pixel says only that there is at least so much light
FINEST = 0.2  # grey levels; a robust scale below this is rounding
NEAR = 0.06  # px; after a step that moves corners less one more is right to 0.002 px, and the first that small brings in all pixels
FIRM = 0.3  # px; a step that moves corners farther leaves the width as it is
STRAYED, WIDENED = 0.4, 1.1  # px that corners may move, times that edges may widen before the pixels near them are collected anew
OK, NO_PIXELS, SINGULAR, WANDERED, NO_CONTRAST, UNSETTLED, NOT_READ = range(7)


@kernel
def _accumulate(points, greys, places, count, cells, g, s, slope, table_x, table_y, light, lit, limit, rows, keep, H, sizes):
    """H (ROWS, ROWS) = J J' over the pixels, whose last row of J is the residual; returns (weights, doubted, told).

    points, greys, places : of `edge_pixels`, the first `count`; slope : (2, 2) of the lens in the middle, image to ideal
    limit : grey levels, of a trusted residual; rows : (chunks, ROWS, CHUNK) J, chunk by chunk where they are to be kept, else all in the first
    sizes : (count,) out, |residual| of the first `told`, which are not saturated
    While it is not lit only the greys' part of J is of use.
    """
    H[:] = 0
    weights, doubted, told = 0.0, 0, 0
    g00, g01, g02, g10, g11, g12, g20, g21 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2], g[2, 0], g[2, 1]
    s00, s01, s10, s11 = slope[0, 0], slope[0, 1], slope[1, 0], slope[1, 1]
    for start in range(0, count, CHUNK):
        size = min(CHUNK, count - start)
        J = rows[start // CHUNK if keep else 0]
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
                sx, sy, rho = s * ax * w, s * ay * w, (Xu * Yu + Xv * Yv) / (ax * ay)
                if REACH * max(sx, sy) > 1:
                    p, dX, dY, dB = wide_pattern(cells, i, j, X, Y, sx, sy, rho, table_x, table_y)
                else:
                    p, dX, dY, dB = pattern(cells, i, j, X, Y, sx, sy, rho, table_x, table_y)
            elif abs(kind) == 1:
                Xx, Xy = g00 - X * g20, g01 - X * g21
                Xu, Xv = Xx * s00 + Xy * s10, Xx * s01 + Xy * s11
                across = kind / (s * w * math.sqrt(Xu * Xu + Xv * Xv))
                h = (X - i) * across
                p, e = edge(table_x, h)
                dX, dB = e * across, -e * h
            else:
                Yx, Yy = g10 - Y * g20, g11 - Y * g21
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
        for i in range(0 if lit else 9, ROWS):
            for j in range(i, ROWS):
                total = np.float32(0)
                for k in range(size):
                    total += J[i, k] * J[j, k]
                H[i, j] += total
    for i in range(ROWS):
        for j in range(i):
            H[i, j] = H[j, i]
    return weights, doubted, told


@kernel
def _corners(g, n, corners, J):
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
def _step(H, g, s, light, n, scale, corners, J, x, L):
    """Move g, light in place by a Gauss-Newton step; returns (px the farthest corner moves, width, status)."""
    if not factor(H, 0, UNKNOWNS, L):
        return 0.0, s, SINGULAR
    solve(L, UNKNOWNS, H[ROWS - 1], x)
    if not _corners(g, n, corners, J):
        return 0.0, s, WANDERED
    moved = 0.0
    for c in range(4):
        du, dv = 0.0, 0.0
        for k in range(8):
            du += J[2 * c, k] * x[k]
            dv += J[2 * c + 1, k] * x[k]
        moved = max(moved, scale * math.sqrt(du * du + dv * dv))
    if not moved < 1e6:
        return 0.0, s, SINGULAR
    short = min(1.0, 0.5 * scale / ((n + 2) * max(moved, 1e-9)))  # never much more than half a cell at once
    for k in range(8):
        g[k // 3, k % 3] += short * x[k]
    for k in range(6):
        light[k] += x[9 + k]
    change = min(max(x[8], -0.3), 0.3) if moved < FIRM else 0.0  # edges out of place look wide
    return short * moved, min(max(s + change * s, 0.25), 6.0), OK


@kernel
def _covariance(H, weights, J, x, L, covariance):
    """(8, 8) covariance of the corners' local ideal coordinates, from the residuals' own scatter; returns that (grey levels).

    x, L : of the last step; x is overwritten
    """
    left = H[ROWS - 1, ROWS - 1]  # the residuals' weighted square, less what the last step takes off it
    for k in range(UNKNOWNS):
        left -= H[ROWS - 1, k] * x[k]
    noise2 = max(left, 1e-12) / max(weights - UNKNOWNS, 1.0)
    unit, row = np.empty(UNKNOWNS), np.empty(8)
    for a in range(8):
        unit[:] = 0
        unit[:8] = J[a]
        solve(L, UNKNOWNS, unit, x)
        for b in range(8):
            row[b] = 0
            for k in range(8):
                row[b] += J[b, k] * x[k]
        covariance[a] = noise2 * row
    return math.sqrt(noise2)


@kernel
def fit_squares(image, starts, boxes, lenses, centres, cells, seen, n, margins, quads, reach, wrong, tables, levels, directions, width, iterations,
                corners, covariances, results, status, profile):
    """Fit every marker of an image.

    image : flat float32, the boxes cut out one after the other from `starts` (m,); boxes : (m, 4) x0 y0 x1 y1 px
    lenses : (m, 2, 10) cubic polynomials from local pixel to local ideal coordinates; centres : (m, 3) x, y, scale px
    cells : (m, n + 4, n + 4) 1 white, 0 black; seen : (m, n + 4, n + 4, 16), their `outlook`; margins : (m,) white margin in cells
    quads : (m, 4, 2) px, first guess in, straightened out; reach : px within which the sides are looked for, 0 for a better guess
    wrong : cells that may be misread before a marker is not believed to be there, or -1 not to look
    width : px, the edges' to start from; tables : (l + 1, d, STEPS + 1, 2) edge spread functions; levels : (l,) px between their widths
    directions : (m, 2) which is that of the X and of the Y edges
    corners : (m, 4, 2) out, px; covariances : (m, 8, 8) out, px^2; status : (m,) out
    profile : (d, bins, 3) added to, what is left beside edges of each direction, see vision/corners/misfit.py; of no bins where it is not wanted
    results : (m, 6) out: noise (grey), contrast, pixels, share of them that count less, width (px), steps taken
    """
    largest = 1
    for m in range(len(boxes)):
        largest = max(largest, (boxes[m, 2] - boxes[m, 0]) * (boxes[m, 3] - boxes[m, 1]))
    points, greys, places = np.empty((2, largest, 2), np.float32), np.empty((2, largest), np.float32), np.empty((2, largest, 3), np.int32)
    sizes, rows = np.zeros(largest, np.float32), np.empty((largest // CHUNK + 1, ROWS, CHUNK), np.float32)
    H, L, x, J = np.empty((ROWS, ROWS)), np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS), np.empty((8, 8))
    sums = np.empty((2, n + 5, n + 5, 2))
    g, light, slope = np.empty((3, 3)), np.empty(6), np.empty((2, 2))
    for m in range(len(boxes)):
        box, lens, scale = boxes[m], lenses[m], centres[m, 2]
        crop = image[starts[m] : starts[m] + (box[2] - box[0]) * (box[3] - box[1])].reshape(box[3] - box[1], box[2] - box[0])
        if reach > 0:
            straighten(crop, box, quads[m], n + 2, reach)
        if wrong >= 0 and misread(crop, box, quads[m], cells[m]) > wrong:
            status[m] = NOT_READ
            continue
        slope[0, 0], slope[0, 1], slope[1, 0], slope[1, 1] = lens[0, 1] / scale, lens[0, 2] / scale, lens[1, 1] / scale, lens[1, 2] / scale
        s, lit, light[:] = width, False, 0
        if not homography(quads[m], lens, centres[m], n, g) or not _corners(g, n, corners[m], J):
            status[m] = WANDERED
            continue
        limit, away, collected, part, used, every, whole = 1e9, 1e9, s, 0, 0, 1, False
        status[m] = UNSETTLED
        for iteration in range(iterations):
            if away > STRAYED or s > WIDENED * collected:
                if iteration > 0:
                    to_image(lens, centres[m], quads[m], corners[m], covariances[m])
                    quads[m] = corners[m]
                count = edge_pixels(crop, box, quads[m], lens, centres[m], seen[m], n, margins[m], g, s, points[0], greys[0], places[0])
                if count < 60:
                    status[m] = NO_PIXELS
                    break
                away, collected, every = 0.0, s, max(count // SAMPLE, 1)
                part = 1 if every > 1 and not whole else 0  # a sample's optimum may lie far enough off to come back to for ever
                for k in range(0, count if part else 0, every):
                    points[1, k // every], greys[1, k // every], places[1, k // every] = points[0, k], greys[0, k], places[0, k]
            used = (count + every - 1) // every if part else count
            level = 0
            while level < len(levels) and s > levels[level]:
                level += 1
            table_x, table_y = tables[level, directions[m, 0]], tables[level, directions[m, 1]]
            weights, doubted, told = _accumulate(points[part], greys[part], places[part], used, cells[m], g, s, slope, table_x, table_y, light, lit,
                                           limit, rows, part == 0, H, sizes)
            if not lit:
                lit = True
                for k in range(6):
                    H[9 + k, 9 + k] += 1e-9 * (1 + H[9 + k, 9 + k])
                if factor(H, 9, 6, L):
                    solve(L, 6, H[ROWS - 1, 9:], light)
                if not light[0] - light[3] > 1:
                    status[m] = NO_CONTRAST
                    break
                continue
            moved, s_new, status_now = _step(H, g, s, light, n, scale, corners[m], J, x, L)
            if status_now != OK:
                status[m] = status_now
                break
            widened, s = abs(s_new - s), s_new
            away += moved
            if part or limit > 1e8:
                limit = TRUSTED * max(1.4826 * np.median(sizes[: max(told, 1)]), FINEST)
            results[m, 1], results[m, 2], results[m, 3] = light[0] - light[3], used, doubted / used
            results[m, 4], results[m, 5] = s, iteration
            if part:
                whole = moved < NEAR and widened < 0.1 * s
                part = 0 if whole else 1
            elif moved < NEAR and widened < 0.05 * s and away < STRAYED and s <= WIDENED * collected:
                if not _corners(g, n, corners[m], J):
                    status[m] = WANDERED
                    break
                segments(points[0], places[0], count, g, rows, x, sums)
                results[m, 0] = _covariance(H, weights, J, x, L, covariances[m])
                covariances[m] *= misfit(sums, results[m, 0])
                to_image(lens, centres[m], quads[m], corners[m], covariances[m])
                status[m], width = OK, s
                if profile.shape[1]:
                    profile_left(points[0], greys[0], places[0], count, g, s, slope, tables[level], directions[m], light, limit, profile)
                break
