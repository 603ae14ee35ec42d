"""Occlusion, illumination and displaced edges in a square fit.

From its residuals: occluded cells, uneven light, displaced edges.

A pixel far off counts little; one beside it, where the edge of what covers the square is blurred, fits well enough to
count and is wrong.

Planes alone make every square seem larger where light falls off to all sides (by 0.002 px where vignetting takes 30 %
in an image's corners, whatever the noise), smaller where it gathers.
"""

import math
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats, Singles
from vision.corners.blurred_edge_image_model_and_numba_kernels import (
    Tables,
    edge_white_share_and_slope,
    fill_cholesky_factor,
    fill_cholesky_solution,
    inlined_kernel,
    kernel,
)
from vision.corners.edge_pixel_white_share_and_derivatives import ROWS, STRIP
from vision.corners.edge_pixels import KINDS, LEVEL, MEETING, EdgePixels
from vision.corners.square_gauss_newton_steps import LIGHT, UNKNOWNS, Square, Work

SIDE = 0.1  # of the information that the best seen cell's side has; one with less does not count
SIDES = (
    16  # of cells, from which it is told whether they are where they ought to be; the homography takes eight of them
)
PROFILED = 3.4  # edge widths on either side of an edge that a profile covers


@kernel
def _near(X: float, top: int) -> int:
    """Cell -2, -1, .. of a coordinate, counted from 0 and held within 0 .. top."""
    return min(max(int(X + 2), 0), top)


@kernel
def fill_edge_segment_sums(pixels: EdgePixels, g: Floats, rows: Floats, last_step: Floats, sums: Floats) -> None:
    """Fill `sums` with sums over the pixels of each edge segment, of slope * residual and slope^2.

    A segment is the side of a cell.
    pixels : EdgePixels; g : (3, 3) homography to cells; rows : as `accumulate` leaves them; last_step : the last step
    """
    first, count = pixels.first, pixels.first[KINDS]
    sums[:] = 0
    last, strip, top = rows.shape[1] - 1, rows.shape[2], sums.shape[1] - 1
    left = np.empty(strip, np.float32)
    for start in range(0, count, strip):
        J, size = rows[start // strip], min(strip, count - start)
        for k in range(size):
            left[k] = J[last, k]
        for i in range(last):
            step = np.float32(last_step[i])
            for k in range(size):
                left[k] -= step * J[i, k]
        for axis in range(2):
            own = J[2 + 3 * axis]
            for k in range(max(first[axis] - start, 0), min(first[axis + 1] - start, size)):
                i, j = pixels.i[start + k] + 2, pixels.j[start + k] + 2
                sums[axis, i, j, 0] += own[k] * left[k]
                sums[axis, i, j, 1] += own[k] * own[k]
        for k in range(max(first[MEETING] - start, 0), size):
            xi, yi = pixels.x[start + k], pixels.y[start + k]
            w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
            X, Y = (g[0, 0] * xi + g[0, 1] * yi + g[0, 2]) * w, (g[1, 0] * xi + g[1, 1] * yi + g[1, 2]) * w
            i, j, column, row = _near(X + 0.5, top), _near(Y + 0.5, top), _near(X, top), _near(Y, top)
            sums[0, i, row, 0] += J[2, k] * left[k]
            sums[0, i, row, 1] += J[2, k] * J[2, k]
            sums[1, column, j, 0] += J[5, k] * left[k]
            sums[1, column, j, 1] += J[5, k] * J[5, k]


@kernel
def corner_covariance_inflation_by_displaced_edges(sums: Floats, noise: float) -> float:
    """Inflation factor of the corners' covariance by displaced edges.

    It is at least 1, where edges are displaced more than noise allows.
    sums : of `fill_edge_segment_sums`; noise : grey levels. White noise leaves a cell's side as far out of place as its
    pixels' slopes say; a blur of another shape, rounding or a renderer's few samples to the pixel move neighbouring
    pixels alike, and sides farther than that.
    Source: a covariance from scores summed over clusters, Liang and Zeger 1986
    """
    square, sides, least = 0.0, 0, SIDE * sums[..., 1].max()
    for axis in range(2):
        for i in range(sums.shape[1]):
            for j in range(sums.shape[2]):
                if sums[axis, i, j, 1] > least:
                    square += sums[axis, i, j, 0] ** 2 / sums[axis, i, j, 1]
                    sides += 1
    return max(square / (noise * noise * (sides - 8)), 1.0) if sides >= SIDES else 1.0


@kernel
def add_residuals_to_edge_profile(
    pixels: EdgePixels, square: Square, bowed: Floats, tables: Tables, directions: Floats, limit: float, profile: Floats
) -> None:
    """Add the residuals near single edges to a profile (d, BINS, 3).

    Count, sum, sum of squares.
    pixels : EdgePixels; square : Square; bowed : (3,) sizes as in bowed.Bow; tables : Tables, of which directions (2,)
    are the rows of the profile for the X and the Y edges; limit : grey levels, of a trusted residual. A bin is a
    distance from the edge in widths, negative on the dark side.
    """
    g, s, slope, light, rows = square.g, square.width, square.slope, square.light, directions
    bins = profile.shape[1]
    for k in range(pixels.first[MEETING]):
        level = k >= pixels.first[LEVEL]
        axis, sign, at_edge, table = (
            (1, pixels.looks[k], pixels.j[k], tables.y) if level else (0, pixels.looks[k], pixels.i[k], tables.x)
        )
        xi, yi = float(pixels.x[k]), float(pixels.y[k])
        w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
        X = (g[axis, 0] * xi + g[axis, 1] * yi + g[axis, 2]) * w
        Xx, Xy = g[axis, 0] - at_edge * g[2, 0], g[axis, 1] - at_edge * g[2, 1]
        Xu, Xv = Xx * slope[0, 0] + Xy * slope[1, 0], Xx * slope[0, 1] + Xy * slope[1, 1]
        h = sign * (X - at_edge) / (s * w * math.sqrt(Xu * Xu + Xv * Xv))
        white, black = light[0] + light[1] * xi + light[2] * yi, light[3] + light[4] * xi + light[5] * yi
        at = int(math.floor((h / PROFILED + 1) * bins / 2))
        p, e = edge_white_share_and_slope(table, h)
        more = bowed[0] * xi * xi + bowed[1] * xi * yi + bowed[2] * yi * yi
        share = (pixels.greys[k] - black - more * (p + (1 - p) * light[3] / light[0])) / (white - black) - p
        if 0 <= at < bins and abs(share) * (white - black) < limit:
            profile[rows[axis], at, 0] += 1
            profile[rows[axis], at, 1] += share
            profile[rows[axis], at, 2] += share * share


SHARE = 0.2  # of a cell's pixels that do not fit, from which something covers it
FEWEST = 3  # such pixels, below which they may be chance, or specks of dirt
FITS = 0.999  # of a residual that is counted whole


@kernel
def _at(xi: float, yi: float, g: Floats, top: int) -> tuple[int, int]:
    """(column, row) of the cell of a point in local ideal coordinates, counted from 0 and held within 0 .. top."""
    w = 1.0 / (g[2, 0] * xi + g[2, 1] * yi + 1.0)
    X, Y = (g[0, 0] * xi + g[0, 1] * yi + g[0, 2]) * w, (g[1, 0] * xi + g[1, 1] * yi + g[1, 2]) * w
    return min(max(int(X + 2), 0), top), min(max(int(Y + 2), 0), top)


@kernel
def mark_occluded_cells(pixels: EdgePixels, g: Floats, rows: Floats, counts: Floats, occluded: Floats) -> bool:
    """Mark occluded cells and their neighbours in `occluded` (k, k) bool; returns whether there are any.

    pixels : EdgePixels; g : (3, 3) homography to cells; rows : as `accumulate` leaves them; counts : (2, k, k)
        overwritten
    """
    strip, top, count = rows.shape[2], occluded.shape[0] - 1, pixels.first[KINDS]
    counts[:] = 0
    for k in range(count):
        J = rows[k // strip]
        root = (
            J[LIGHT, k % strip] + J[LIGHT + 3, k % strip]
        )  # the shares of white and of black, which a pixel that counts less has less of
        if root > 0:
            i, j = _at(pixels.x[k], pixels.y[k], g, top)
            counts[0, j, i] += 1
            counts[1, j, i] += root < FITS
    found = False
    for j in range(top + 1):
        for i in range(top + 1):
            if counts[1, j, i] >= FEWEST and counts[1, j, i] >= SHARE * counts[0, j, i]:
                occluded[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2] = True
                found = True
    return found


@kernel
def remove_occluded_pixels(pixels: EdgePixels, g: Floats, occluded: Floats) -> int:
    """Remove the EdgePixels in occluded cells (k, k), in place.

    g : (3, 3) homography to cells
    Returns how many remain
    """
    rows, top, start = 0, occluded.shape[0] - 1, 0
    for kind in range(KINDS):
        for k in range(start, pixels.first[kind + 1]):
            i, j = _at(pixels.x[k], pixels.y[k], g, top)
            pixels.x[rows], pixels.y[rows], pixels.greys[rows] = pixels.x[k], pixels.y[k], pixels.greys[k]
            pixels.i[rows], pixels.j[rows], pixels.looks[rows] = pixels.i[k], pixels.j[k], pixels.looks[k]
            rows += not occluded[j, i]
        start, pixels.first[kind + 1] = pixels.first[kind + 1], rows
    return rows


TERMS = 3  # x^2, x y, y^2 of local coordinates, which reach to about 1 on either side of a square's middle
PLAUSIBLE = 0.02  # of the grey of white, that light may be bowed by from a square's middle to its rim


class Bow(NamedTuple):
    """gain : (TERMS, UNKNOWNS) by how much a fit's unknowns fall with each term; own : (TERMS, TERMS) the terms'
    covariance, over the noise's
    sizes : (TERMS,) grey levels, the terms."""

    gain: Floats
    own: Floats
    sizes: Floats


@kernel
def correct_square_fit_for_uneven_illumination(
    pixels: EdgePixels, square: Square, weight_sum: float, work: Work, bow: Bow
) -> float:
    """Correct a square fit for uneven illumination.

    It is removed from a settled fit by one last step of its Square and residuals.
    pixels : EdgePixels, of all of which work holds rows; weight_sum : sum of their weights; bow : Bow, overwritten
    Returns the weighted square of the residuals that is left, grey levels
    """
    gain, own, sizes, light = bow.gain, bow.own, bow.sizes, square.light
    H, L, x, rows, count = work.H, work.L, work.x, work.rows, pixels.first[KINDS]
    left = H[ROWS - 1, ROWS - 1]
    for k in range(UNKNOWNS):
        left -= H[ROWS - 1, k] * x[k]
    held = max(left, 1e-12) / max(weight_sum - UNKNOWNS, 1.0) / (PLAUSIBLE * light[0]) ** 2
    black = light[3] / light[0]
    cross, within, E = np.zeros((TERMS, ROWS)), np.zeros((TERMS, TERMS)), np.empty((TERMS, STRIP), np.float32)
    _products(pixels, rows, black, E, cross, within)
    right, M, unit = np.empty(TERMS), np.empty((TERMS, TERMS)), np.empty(TERMS)
    for a in range(TERMS):
        fill_cholesky_solution(L, UNKNOWNS, cross[a], gain[a])
        right[a] = cross[a, ROWS - 1]
        for k in range(UNKNOWNS):
            right[a] -= cross[a, k] * x[k]
    for a in range(TERMS):
        for b in range(a, TERMS):
            for k in range(UNKNOWNS):
                within[a, b] -= cross[a, k] * gain[b, k]
            within[b, a] = within[a, b]
        within[a, a] += held
    own[:], sizes[:] = 0, 0
    if not fill_cholesky_factor(within, 0, TERMS, M):
        return left
    fill_cholesky_solution(M, TERMS, right, sizes)
    for a in range(TERMS):
        unit[:] = 0
        unit[a] = 1
        fill_cholesky_solution(M, TERMS, unit, own[a])
        left -= right[a] * sizes[a]
        for k in range(UNKNOWNS):
            x[k] -= gain[a, k] * sizes[a]
        for k in range(8):
            square.g[k // 3, k % 3] -= gain[a, k] * sizes[a]
        for k in range(6):
            light[k] -= gain[a, LIGHT + k] * sizes[a]
    for start in range(0, count, STRIP):
        J, size = rows[start // STRIP], min(STRIP, count - start)
        _bowed(pixels, start, size, black, J, E)
        for a in range(TERMS):
            for k in range(size):
                J[ROWS - 1, k] -= np.float32(sizes[a]) * E[a, k]
    return left


@inlined_kernel
def _products(pixels: EdgePixels, rows: Floats, black: float, E: Singles, cross: Floats, within: Floats) -> None:
    """Add to cross (TERMS, ROWS) and to within (TERMS, TERMS), above its diagonal, sums of what bowed light does to all
    pixels times their rows,
    and times itself. E : overwritten"""
    count = pixels.first[KINDS]
    for start in range(0, count, STRIP):
        J, size = rows[start // STRIP], min(STRIP, count - start)
        _bowed(pixels, start, size, black, J, E)
        for a in range(TERMS):
            for i in range(ROWS):
                total = np.float32(0)
                for k in range(size):
                    total += E[a, k] * J[i, k]
                cross[a, i] += total
            for b in range(a, TERMS):
                total = np.float32(0)
                for k in range(size):
                    total += E[a, k] * E[b, k]
                within[a, b] += total


@kernel
def _bowed(pixels: EdgePixels, start: int, size: int, black: float, J: Floats, E: Singles) -> None:
    """E (TERMS, STRIP) what bowed light does to the pixels start .. start + size, whose rows are J. black : grey of
    black over that of white
    """
    for k in range(size):
        u, v = pixels.x[start + k], pixels.y[start + k]
        share = J[LIGHT, k] + np.float32(black) * J[LIGHT + 3, k]
        E[0, k], E[1, k], E[2, k] = share * u * u, share * u * v, share * v * v
