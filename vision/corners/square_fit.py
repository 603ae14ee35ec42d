"""Fit of one printed square to its pixels.

Homography, lens, blur and pixel grid.

The whole marker is fitted at once (Gauss-Newton on the pixels near its edges): the homography from image to cells (8
unknowns), the width of the edges (1), and the grey of black and of white, each a plane over the image (6). How
brightness climbs across an edge is a tabulated edge spread function, the pixel's own width included: a Gaussian's, or
one learnt from the images (vision/corners/edge_spread_function.py), one for each direction of edges. Where two edges
meet, their product is corrected by a bivariate normal's correlated part
(vision/corners/blurred_edge_image_model_and_numba_kernels.py), because a marker's axes are seldom square in the
image.
Source: corner accuracy from edges, Rohr 1992; dense alignment of a marker, Wu et al., DodecaPen, UIST 2017
"""

import math
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats, Integers
from vision.corners.blurred_edge_image_model_and_numba_kernels import (
    STEPS,
    Tables,
    fill_cholesky_factor,
    fill_cholesky_solution,
    fill_edge_spread_table,
    inlined_kernel,
    kernel,
    order_statistic,
)
from vision.corners.edge_pixel_white_share_and_derivatives import ROWS, STRIP
from vision.corners.edge_pixels import KINDS, EdgePixels, Printed, Raster, collect_edge_pixels
from vision.corners.local_lens_and_fit_start import (
    convert_corners_and_covariance_to_pixels_in_place,
    fill_square_homography,
    fit_quad_sides_in_place,
    misread_cell_count,
)
from vision.corners.occlusion_illumination_and_displaced_edges_in_square_fit import (
    TERMS,
    Bow,
    add_residuals_to_edge_profile,
    corner_covariance_inflation_by_displaced_edges,
    correct_square_fit_for_uneven_illumination,
    fill_edge_segment_sums,
    mark_occluded_cells,
    remove_occluded_pixels,
)
from vision.corners.square_gauss_newton_steps import (
    LIGHT,
    NO_CONTRAST,
    NO_PIXELS,
    NOT_READ,
    OK,
    UNKNOWNS,
    UNLIMITED,
    UNSETTLED,
    WANDERED,
    Square,
    Work,
    accumulate_normal_equations,
    fill_corner_covariance,
    fill_homography_corners_and_jacobian,
    gauss_newton_step,
)

SAMPLE = 300  # pixels that take part while the fit is still on its way
FEWEST = 60  # pixels near edges, below which nothing is fitted
TRUSTED = 5.0  # robust standard deviations; a pixel farther off counts less, and soon nothing: something covers it
FINEST = 0.2  # grey levels; a robust scale below this is rounding
FAINTEST = 1.0  # grey levels that white must be brighter than black
# px; after a step that moves corners less one more is right to 0.002 px, and the first that small brings in all pixels
SETTLED = 0.06
SAMPLE_STEADY, STEADY = (
    0.1,
    0.05,
)  # of the edges' width, that a step may change it by once it is settled: with a sample, with all pixels
SAMPLED = 10  # times that pixels are collected of which a sample takes part
STRAYED, WIDENED = (
    0.4,
    1.1,
)  # px that corners may move, times that edges may widen before the pixels near them are collected anew


class Squares(NamedTuple):
    """Markers of one size in one image.

    pixels : flat float32, 255ths of white, the boxes cut out one after the other from `starts` (m + 1,); boxes : (m, 4)
        x0 y0 x1 y1 px
    lenses : (m, 2, TERMS), centres : (m, 3), cells : (m, n + 4, n + 4), outlooks : (m, NOWHERE + 1), margins : (m,)
        cells and
    directions : (m, 2) of each, see Printed
    """

    pixels: Floats
    starts: Floats
    boxes: Floats
    lenses: Floats
    centres: Floats
    cells: Floats
    outlooks: Floats
    margins: Floats
    directions: Integers


class FitSettings(NamedTuple):
    """How squares are fitted.

    reach : px within which the sides are looked for, 0 for a better guess; wrong : cells that may be misread before a
    marker is not believed to be there, or -1 not to look; iterations : steps at most
    tables : (l + 1, d, STEPS + 1, 2) edge spread functions; levels : (l,) px between their widths; width : px, the
        edges' to start from
    """

    reach: float
    wrong: int
    iterations: int
    tables: Floats
    levels: Floats
    width: float


class Fits(NamedTuple):
    """What fitting finds, written in place, for m squares.

    quads : (m, 4, 2) px, first guess in, straightened out; corners : (m, 4, 2) px; covariances : (m, 8, 8) px^2
    noise, contrast : (m,) grey levels; used : (m,) pixels; doubted : (m,) share of them that count less; width : (m,)
        px
    steps : (m,); status : (m,) OK, or why there is none
    profile : (d, bins, 3) added to, what is left beside edges of each direction, see
        vision/corners/occlusion_illumination_and_displaced_edges_in_square_fit.py; of no bins where it is
    not wanted
    """

    quads: Floats
    corners: Floats
    covariances: Floats
    noise: Floats
    contrast: Floats
    used: Floats
    doubted: Floats
    width: Floats
    steps: Floats
    status: Floats
    profile: Floats


class Room(NamedTuple):
    """What fits are worked out in: all pixels of a marker near edges, a sample of them, a raster to collect them in,
    Work, Bow, Tables, sums of `fill_edge_segment_sums`, and counts and cells of `mark_occluded_cells`."""

    every: EdgePixels
    sample: EdgePixels
    raster: Raster
    work: Work
    bowed: Bow
    tables: Tables
    sums: Floats
    outlooks: Floats
    hidden: Floats


@kernel
def _pixels(most: int) -> EdgePixels:
    """EdgePixels with room for `most`."""
    x, y, greys = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
    return EdgePixels(
        x,
        y,
        greys,
        np.empty(most, np.int32),
        np.empty(most, np.int32),
        np.empty(most, np.int32),
        np.zeros(KINDS + 1, np.int64),
    )


@inlined_kernel
def _room(largest: int, widest: int, n: int) -> Room:
    """Room for markers of n bits each way in boxes of at most so many pixels and columns."""
    x, y, greys = np.empty(largest, np.float32), np.empty(largest, np.float32), np.empty(largest, np.float32)
    raster = Raster(
        np.empty((4, widest), np.float32), np.empty(widest, np.int32), x, y, greys, np.empty(largest, np.int32)
    )
    work = Work(
        np.empty((ROWS, ROWS)),
        np.empty((UNKNOWNS, UNKNOWNS)),
        np.empty(UNKNOWNS),
        np.empty((8, 8)),
        np.empty((largest // STRIP + 1, ROWS, STRIP), np.float32),
        np.empty(largest, np.float32),
    )
    bowed = Bow(np.empty((TERMS, UNKNOWNS)), np.empty((TERMS, TERMS)), np.empty(TERMS))
    tables = Tables(np.empty((STEPS, 4), np.float32), np.empty((STEPS, 4), np.float32))
    return Room(
        _pixels(largest),
        _pixels(largest),
        raster,
        work,
        bowed,
        tables,
        np.empty((2, n + 5, n + 5, 2)),
        np.empty((2, n + 5, n + 5)),
        np.empty((n + 5, n + 5), np.bool_),
    )


@inlined_kernel
def _take(every: EdgePixels, sample: EdgePixels, stride: int) -> int:
    """Copy each stride-th pixel of each kind into the sample; returns how many."""
    m, sample.first[0] = 0, 0
    for kind in range(KINDS):
        for k in range(every.first[kind], every.first[kind + 1], stride):
            sample.x[m], sample.y[m], sample.greys[m] = every.x[k], every.y[k], every.greys[k]
            sample.i[m], sample.j[m], sample.looks[m] = every.i[k], every.j[k], every.looks[k]
            m += 1
        sample.first[kind + 1] = m
    return m


@inlined_kernel
def _median(sizes: Floats) -> float:
    """Median of those sizes (k,) that are not negative."""
    negative = 0
    for size in sizes:
        negative += size < 0
    return order_statistic(sizes, (len(sizes) + negative) // 2)


@inlined_kernel
def _lighten(work: Work, light: Floats) -> bool:
    """Set the greys from normal equations in which the square's place is held; False where white is no brighter than
    black.
    """
    H = work.H
    for k in range(6):
        H[LIGHT + k, LIGHT + k] += 1e-9 * (1 + H[LIGHT + k, LIGHT + k])
    if fill_cholesky_factor(H, LIGHT, 6, work.L):
        fill_cholesky_solution(work.L, 6, H[ROWS - 1, LIGHT:], light)
    return light[0] - light[3] > FAINTEST


@kernel
def fit_squares(squares: Squares, settings: FitSettings, fits: Fits) -> None:
    """Fit all marker squares of an image.

    Squares in the given Manner, into Fits.
    """
    boxes, n, width = squares.boxes, squares.cells.shape[1] - 4, settings.width
    largest, widest = 1, 1
    for m in range(len(boxes)):
        largest = max(largest, (boxes[m, 2] - boxes[m, 0]) * (boxes[m, 3] - boxes[m, 1]))
        widest = max(widest, boxes[m, 2] - boxes[m, 0])
    room = _room(largest, widest, n)
    for m in range(len(boxes)):
        marker = Printed(
            squares.cells[m],
            squares.outlooks[m],
            n,
            squares.margins[m],
            squares.directions[m],
            boxes[m],
            squares.lenses[m],
            squares.centres[m],
        )
        box = boxes[m]
        crop = squares.pixels[squares.starts[m] : squares.starts[m] + (box[2] - box[0]) * (box[3] - box[1])].reshape(
            box[3] - box[1], box[2] - box[0]
        )
        if settings.reach > 0:
            fit_quad_sides_in_place(crop, box, fits.quads[m], n + 2, settings.reach)
        if settings.wrong >= 0 and misread_cell_count(crop, box, fits.quads[m], marker.cells) > settings.wrong:
            fits.status[m] = NOT_READ
            continue
        fits.status[m] = _fit_square(crop, marker, m, width, settings, fits, room)
        if fits.status[m] == OK:
            width = fits.width[m]


@inlined_kernel
def _tabulated(tables: Tables, before: int, s: float, manner: FitSettings, directions: Floats) -> int:
    """Level of the edges' width s (px), whose edge spread functions in directions (2,) are in the tables then;
    before : that of those that were
    """
    level = 0
    while level < len(manner.levels) and s > manner.levels[level]:
        level += 1
    if level != before:
        fill_edge_spread_table(manner.tables[level, directions[0]], tables.x)
        fill_edge_spread_table(manner.tables[level, directions[1]], tables.y)
    return level


@inlined_kernel
def _finish(room: Room, square: Square, marker: Printed, m: int, weights: float, limit: float, fits: Fits) -> int:
    """Status of a fit that has settled, number m of the Fits: bowed light taken out of it, its corners, noise and
    covariance told.

    weights : sum of its pixels' weights; limit : grey levels, of a trusted residual
    """
    every, work, corners, covariance = room.every, room.work, fits.corners[m], fits.covariances[m]
    over = correct_square_fit_for_uneven_illumination(every, square, weights, work, room.bowed)
    if not fill_homography_corners_and_jacobian(square.g, marker.n, corners, work.J):
        return WANDERED
    fill_edge_segment_sums(every, square.g, work.rows, work.x, room.sums)
    noise2 = max(over, 1e-12) / max(weights - UNKNOWNS - TERMS, 1.0)
    fits.noise[m] = math.sqrt(noise2)
    fill_corner_covariance(work, noise2, room.bowed.gain, room.bowed.own, covariance)
    covariance *= corner_covariance_inflation_by_displaced_edges(room.sums, fits.noise[m])
    convert_corners_and_covariance_to_pixels_in_place(marker.lens, marker.centre, fits.quads[m], corners, covariance)
    if fits.profile.shape[1]:
        add_residuals_to_edge_profile(
            every, square, room.bowed.sizes, room.tables, marker.directions, limit, fits.profile
        )
    return OK


@inlined_kernel
def _fit_square(crop: Floats, marker: Printed, m: int, s: float, manner: FitSettings, fits: Fits, room: Room) -> int:
    """Status of the fit of one marker, number m of the Fits, from edges of width s (px) on. room : of `_room`"""
    every, sample, work, hidden, tables = room.every, room.sample, room.work, room.hidden, room.tables
    hidden[:] = False
    n, lens, centre, quad, corners = marker.n, marker.lens, marker.centre, fits.quads[m], fits.corners[m]
    scale = centre[2]
    g, light, slope = np.empty((3, 3)), np.zeros(6), np.empty((2, 2))
    slope[0, 0], slope[0, 1], slope[1, 0], slope[1, 1] = (
        lens[0, 1] / scale,
        lens[0, 2] / scale,
        lens[1, 1] / scale,
        lens[1, 2] / scale,
    )
    if not fill_square_homography(quad, lens, centre, n, g) or not fill_homography_corners_and_jacobian(
        g, n, corners, work.J
    ):
        return WANDERED
    # a plain False would be a type of its own, and what takes it compiled once more
    lit, limit, away, collected, part, count, used, whole, tabulated = (
        bool(np.bool_(False)),
        UNLIMITED,
        np.inf,
        s,
        False,
        0,
        0,
        False,
        -1,
    )
    collections = 0
    lost, dropped = 0, 0  # pixels that did not fit and were dropped, all that were dropped with them
    for iteration in range(manner.iterations):
        if away > STRAYED or s > WIDENED * collected:
            if iteration > 0:
                convert_corners_and_covariance_to_pixels_in_place(lens, centre, quad, corners, fits.covariances[m])
                for k in range(4):
                    quad[k, 0], quad[k, 1] = corners[k, 0], corners[k, 1]
            pixel_count = collect_edge_pixels(crop, marker, quad, g, s, room.raster, every)
            count = remove_occluded_pixels(every, g, hidden) if dropped else pixel_count
            dropped = pixel_count - count
            if count < FEWEST:
                return NO_PIXELS
            away, collected, stride = 0.0, s, max(count // SAMPLE, 1)
            collections += 1
            part = (
                stride > 1 and not whole and collections <= SAMPLED
            )  # a sample's optimum may lie far enough off to come back to for ever
            if part:
                used = _take(every, sample, stride)
        tabulated = _tabulated(tables, tabulated, s, manner, marker.directions)
        square = Square(g, s, light, slope)
        used = used if part else count
        counted = accumulate_normal_equations(sample if part else every, marker.cells, square, tables, limit, lit, work)
        if not lit:
            lit = True
            if not _lighten(work, light):
                return NO_CONTRAST
            continue
        moved = gauss_newton_step(square, n, scale, corners, work)
        if moved.status != OK:
            return moved.status
        widened, s = abs(moved.width - s), moved.width
        away += moved.moved
        if part or limit == UNLIMITED:
            limit = TRUSTED * max(1.4826 * _median(work.sizes[:used]), FINEST)
        fits.contrast[m], fits.used[m], fits.doubted[m] = (
            light[0] - light[3],
            used,
            (lost + counted.doubted) / (used + dropped),
        )
        fits.width[m], fits.steps[m] = s, iteration
        if part:
            whole = moved.moved < SETTLED and widened < SAMPLE_STEADY * s
            part = not whole
        elif moved.moved < SETTLED and widened < STEADY * s and away < STRAYED and s <= WIDENED * collected:
            if counted.doubted and mark_occluded_cells(every, g, work.rows, room.outlooks, hidden):
                lost, left = lost + counted.doubted, remove_occluded_pixels(every, g, hidden)
                dropped, count = dropped + count - left, left
                if count < FEWEST:
                    return NO_PIXELS
                continue
            return _finish(room, Square(g, s, light, slope), marker, m, counted.weights, limit, fits)
    return UNSETTLED
