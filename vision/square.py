"""The image of one printed square: a known pattern of cells, seen through a homography, a lens, blur and a pixel grid.

The whole marker is fitted at once (Gauss-Newton on its pixels): the homography from image to cells (8 unknowns), the blur
(1), and the grey of black and of white, each a plane over the marker (6). The blur is a Gaussian that includes the pixel's
own width; along a marker's skewed axes it is a bivariate normal, whose correlated part is integrated where two edges meet.
Source: corner accuracy from edges, Rohr 1992; dense alignment of a marker, Wu et al., DodecaPen, UIST 2017; bivariate normal,
Drezner and Wesolowsky 1990.
"""

import math

import numpy as np
from numba import njit

UNKNOWNS = 15
REACH = 3.2  # blur widths on either side of an edge that are looked at
CLEAR = 2.5  # blur widths kept clear of whatever lies beyond the white margin
TRUSTED = 5.0  # robust standard deviations; a pixel farther off counts less, and soon nothing: something covers it
FINEST = 0.2  # grey levels; a robust scale below this is rounding
STEPS = 2048
SPAN = 8.0  # the tabulated normal reaches from -SPAN/2 to SPAN/2
_grid = np.linspace(-SPAN / 2, SPAN / 2, STEPS + 1)
_CDF = np.array([0.5 * math.erfc(-x / math.sqrt(2)) for x in _grid])
_PDF = np.exp(-_grid * _grid / 2) / math.sqrt(2 * math.pi)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
OK, NO_PIXELS, SINGULAR, WANDERED, NO_CONTRAST, UNSETTLED = range(6)


@njit(cache=True, fastmath=True)
def _normal(x):
    """Normal distribution and density at x, from a table (1e-6)."""
    at = (x + SPAN / 2) * (STEPS / SPAN)
    if at <= 0:
        return 0.0, 0.0
    if at >= STEPS:
        return 1.0, 0.0
    i = int(at)
    f = at - i
    return _CDF[i] + f * (_CDF[i + 1] - _CDF[i]), _PDF[i] + f * (_PDF[i + 1] - _PDF[i])


@njit(cache=True, fastmath=True)
def _corner_part(h, k, rho):
    """Bivariate normal distribution less the product of its margins."""
    total = 0.0
    for g in range(4):
        r = 0.5 * rho * (_NODES[g] + 1)
        q = 1 - r * r
        total += _WEIGHTS[g] * math.exp(-(h * h - 2 * r * h * k + k * k) / (2 * q)) / math.sqrt(q)
    return total * rho / (4 * math.pi)


@njit(cache=True, fastmath=True)
def _pattern(cells, n, X, Y, sx, sy, rho, out):
    """White share at cell coordinates X, Y under blur sx, sy (cells) of correlation rho; out: value, d/dX, d/dY, d/dblur.

    cells : (n + 4, n + 4), the n x n bits with their black border and one more ring of white. Cell (0, 0) is the first bit.
    """
    i = int(math.floor(X))
    j = int(math.floor(Y))
    i = min(max(i, -2), n + 1)
    j = min(max(j, -2), n + 1)
    hl, hr, vl, vr = (X - i) / sx, (X - i - 1) / sx, (Y - j) / sy, (Y - j - 1) / sy
    Pa, pa = _normal(hl)
    Pb, pb = _normal(hr)
    Pc, pc = _normal(vl)
    Pd, pd = _normal(vr)
    wx = (1 - Pa, Pa - Pb, Pb)
    wy = (1 - Pc, Pc - Pd, Pd)
    dx = (-pa / sx, (pa - pb) / sx, pb / sx)
    dy = (-pc / sy, (pc - pd) / sy, pd / sy)
    bx = (pa * hl, pb * hr - pa * hl, -pb * hr)  # d wx / d ln(blur)
    by = (pc * vl, pd * vr - pc * vl, -pd * vr)
    s, gx, gy, gb = 0.0, 0.0, 0.0, 0.0
    for v in range(3):
        rx, rdx, rbx = 0.0, 0.0, 0.0
        for u in range(3):
            c = cells[min(max(j + v + 1, 0), n + 3), min(max(i + u + 1, 0), n + 3)]
            rx += c * wx[u]
            rdx += c * dx[u]
            rbx += c * bx[u]
        s += wy[v] * rx
        gx += wy[v] * rdx
        gy += dy[v] * rx
        gb += wy[v] * rbx + by[v] * rx
    if abs(rho) > 0.01:
        for u in range(2):
            h = hl if u == 0 else hr
            if abs(h) > 4:
                continue
            for v in range(2):
                k = vl if v == 0 else vr
                if abs(k) > 4:
                    continue
                y0, y1 = min(max(j + v + 1, 0), n + 3), min(max(j + v + 2, 0), n + 3)
                x0, x1 = min(max(i + u + 1, 0), n + 3), min(max(i + u + 2, 0), n + 3)
                w = cells[y0, x0] - cells[y0, x1] - cells[y1, x0] + cells[y1, x1]
                if w != 0:
                    s += w * _corner_part(h, k, rho)
    out[0], out[1], out[2], out[3] = s, gx, gy, gb


@njit(cache=True, fastmath=True, nogil=True)
def fit_squares(image, boxes, lenses, centres, cells, n, margins, G, blur, iterations, results, covariances, status):
    """Fit every marker of an image, in place.

    image : (height, width) float32; boxes : (m, 4) x0 y0 x1 y1 px, pixels to look at
    lenses : (m, 2, 10) cubic polynomials from local pixel to local ideal coordinates; centres : (m, 3) x, y, scale px
    cells : (m, n + 4, n + 4) 1 white, 0 black; margins : (m,) white margin in cells
    G : (m, 3, 3) homography, local ideal to cell coordinates, first guess in, answer out; blur : (m,) px, likewise
    results : (m, 6) out: noise (grey), contrast, pixels, share of them that count less, black, steps taken
    covariances : (m, 15, 15) out, unknowns 0..7 the homography's, 8 the blur's; status : (m,) out
    """
    p = np.empty(4)
    J = np.empty(UNKNOWNS)
    largest = 0
    for m in range(len(boxes)):
        largest = max(largest, (boxes[m, 2] - boxes[m, 0]) * (boxes[m, 3] - boxes[m, 1]))
    absolute = np.empty(largest)
    for m in range(len(boxes)):
        x0, y0, x1, y1 = boxes[m]
        cx, cy, scale = centres[m]
        lens = lenses[m]
        g = G[m]
        s = blur[m]
        light = np.zeros(6)
        have_light = False
        scatter = 1e9  # robust standard deviation of the residuals
        status[m] = UNSETTLED
        half = (n + 2) / 2.0
        mid = n / 2.0
        for iteration in range(iterations):
            H = np.zeros((UNKNOWNS, UNKNOWNS))
            b = np.zeros(UNKNOWNS)
            count, total, weights, doubted = 0, 0.0, 0.0, 0
            # the lens's and the homography's slope in the middle give the blur's shape, updated pixel by pixel for perspective
            for y in range(y0, y1):
                v = (y - cy) / scale
                for x in range(x0, x1):
                    u = (x - cx) / scale
                    xi = lens[0, 0] + u * (lens[0, 1] + u * (lens[0, 3] + u * lens[0, 6])) + v * (
                        lens[0, 2] + u * (lens[0, 4] + u * lens[0, 7]) + v * (lens[0, 5] + u * lens[0, 8] + v * lens[0, 9]))
                    yi = lens[1, 0] + u * (lens[1, 1] + u * (lens[1, 3] + u * lens[1, 6])) + v * (
                        lens[1, 2] + u * (lens[1, 4] + u * lens[1, 7]) + v * (lens[1, 5] + u * lens[1, 8] + v * lens[1, 9]))
                    w = g[2, 0] * xi + g[2, 1] * yi + g[2, 2]
                    if w < 1e-3:
                        continue
                    X = (g[0, 0] * xi + g[0, 1] * yi + g[0, 2]) / w
                    Y = (g[1, 0] * xi + g[1, 1] * yi + g[1, 2]) / w
                    outx = max(-1 - X, X - (n + 1))
                    outy = max(-1 - Y, Y - (n + 1))
                    if outx > margins[m] or outy > margins[m]:
                        continue
                    Xx, Xy = (g[0, 0] - X * g[2, 0]) / w, (g[0, 1] - X * g[2, 1]) / w
                    Yx, Yy = (g[1, 0] - Y * g[2, 0]) / w, (g[1, 1] - Y * g[2, 1]) / w
                    # lens slope at the marker's middle; perspective is followed exactly
                    Xu, Xv = (Xx * lens[0, 1] + Xy * lens[1, 1]) / scale, (Xx * lens[0, 2] + Xy * lens[1, 2]) / scale
                    Yu, Yv = (Yx * lens[0, 1] + Yy * lens[1, 1]) / scale, (Yx * lens[0, 2] + Yy * lens[1, 2]) / scale
                    ax, ay = math.sqrt(Xu * Xu + Xv * Xv), math.sqrt(Yu * Yu + Yv * Yv)
                    if outx > margins[m] - CLEAR * s * ax or outy > margins[m] - CLEAR * s * ay:
                        continue
                    if outx > REACH * s * ax or outy > REACH * s * ay:
                        continue
                    fx, fy = X - math.floor(X), Y - math.floor(Y)
                    if min(fx, 1 - fx) > REACH * s * ax and min(fy, 1 - fy) > REACH * s * ay:
                        continue
                    rho = (Xu * Yu + Xv * Yv) / (ax * ay)
                    _pattern(cells[m], n, X, Y, s * ax, s * ay, rho, p)
                    xc, yc = (X - mid) / half, (Y - mid) / half
                    grey = image[y, x]
                    white = 1 - p[0]
                    J[9], J[10], J[11] = p[0], p[0] * xc, p[0] * yc
                    J[12], J[13], J[14] = white, white * xc, white * yc
                    if have_light:
                        r = grey - (light[0] * J[9] + light[1] * J[10] + light[2] * J[11]
                                    + light[3] * J[12] + light[4] * J[13] + light[5] * J[14])
                        amplitude = light[0] - light[3] + (light[1] - light[4]) * xc + (light[2] - light[5]) * yc
                        dX, dY = amplitude * p[1] / w, amplitude * p[2] / w
                        J[0], J[1], J[2] = dX * xi, dX * yi, dX
                        J[3], J[4], J[5] = dY * xi, dY * yi, dY
                        both = -(dX * X + dY * Y)
                        J[6], J[7] = both * xi, both * yi
                        J[8] = amplitude * p[3] / s
                        weight, first = 1.0, 0
                        if abs(r) > TRUSTED * scatter:
                            weight = (TRUSTED * scatter / abs(r)) ** 3
                            doubted += 1
                        absolute[count] = abs(r)
                    else:
                        r, weight, first = grey, 1.0, 9
                    count += 1
                    weights += weight
                    total += weight * r * r
                    for i in range(first, UNKNOWNS):
                        a = weight * J[i]
                        b[i] += a * r
                        for j in range(i, UNKNOWNS):
                            H[i, j] += a * J[j]
            if count < 40:
                status[m] = NO_PIXELS
                break
            for i in range(UNKNOWNS):
                for j in range(i):
                    H[i, j] = H[j, i]
            if not have_light:
                for i in range(6):
                    H[9 + i, 9 + i] *= 1 + 1e-9
                    H[9 + i, 9 + i] += 1e-9
                light[:] = np.linalg.solve(H[9:, 9:], b[9:])
                have_light = True
                if light[0] - light[3] < 1:
                    status[m] = NO_CONTRAST
                    break
                continue
            trace = 0.0
            for i in range(UNKNOWNS):
                trace = max(trace, H[i, i])
            for i in range(UNKNOWNS):
                H[i, i] += 1e-12 * trace
            step = np.linalg.solve(H, b)
            if not np.isfinite(step).all():
                status[m] = SINGULAR
                break
            noise = math.sqrt(max(total / weights, 1e-12))
            scatter = max(1.4826 * np.median(absolute[:count]), FINEST)
            ds = min(max(step[8], -0.3 * s), 0.3 * s)
            moved = 0.0
            for k in range(4):  # how far the step moves the square's corners, in cells
                X = -1.0 if k == 0 or k == 3 else n + 1.0
                Y = -1.0 if k < 2 else n + 1.0
                det, xi, yi = _back(g, X, Y)
                if det <= 0:
                    status[m] = WANDERED
                    break
                w = g[2, 0] * xi + g[2, 1] * yi + g[2, 2]
                dX = (step[0] * xi + step[1] * yi + step[2] - X * (step[6] * xi + step[7] * yi)) / w
                dY = (step[3] * xi + step[4] * yi + step[5] - Y * (step[6] * xi + step[7] * yi)) / w
                moved = max(moved, math.sqrt(dX * dX + dY * dY))
            if status[m] == WANDERED:
                break
            short = min(1.0, 0.5 / max(moved, 1e-9))  # never more than half a cell at once
            for i in range(8):
                g[i // 3, i % 3] += short * step[i]
            s = min(max(s + short * ds, 0.25), 6.0)
            for i in range(6):
                light[i] += step[9 + i]
            results[m, 0], results[m, 1], results[m, 2] = noise, light[0] - light[3], count
            results[m, 3], results[m, 4], results[m, 5] = doubted / count, light[3], iteration
            if moved < 2e-4 and abs(ds) < 2e-3 * s and iteration > 3:
                covariances[m] = np.linalg.inv(H) * noise * noise * (weights / max(weights - UNKNOWNS, 1.0))
                status[m] = OK
                break
        blur[m] = s


@njit(cache=True, fastmath=True)
def _back(g, X, Y):
    """Local ideal coordinates of cell coordinates; the first figure is positive where the square has not flipped over."""
    a, b, c = g[0, 0] - X * g[2, 0], g[0, 1] - X * g[2, 1], X * g[2, 2] - g[0, 2]
    d, e, f = g[1, 0] - Y * g[2, 0], g[1, 1] - Y * g[2, 1], Y * g[2, 2] - g[1, 2]
    det = a * e - b * d
    if abs(det) < 1e-12:
        return -1.0, 0.0, 0.0
    xi, yi = (c * e - b * f) / det, (a * f - c * d) / det
    return det * (g[2, 0] * xi + g[2, 1] * yi + g[2, 2]), xi, yi
