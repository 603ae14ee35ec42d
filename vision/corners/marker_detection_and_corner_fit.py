"""Marker detection in an image, and corner fit.

Markers are read or expected; corners come with covariance, by the fit of the whole square.

Markers are read in the whole image: quadrangles, their bits, the identities of a rig's markers.

Source: Garrido-Jurado et al., Pattern Recognition 47, 2014
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple, cast

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.model.design import Camera
from vision.corners import edge_pixels, local_lens_and_fit_start, square_fit, square_gauss_newton_steps
from vision.corners.edge_spread_function import LEVELS, NO_PROFILE, PLAIN_EDGE_SPREAD, EdgeSpread
from vision.marker_corner_prediction import MarkerMap, expected_marker_rows_and_corners_in_image, marker_cells

CELL_PIXELS = 8  # pixels each way that are sampled in a cell
# of a candidate's perimeter, within which another one is taken for the same marker. OpenCV's 0.125 takes the marker and
# the outline of its white margin, or of the cube's face, for one, and then reads only one of them
SAME_MARKER = 0.07


class ExcludedMarker(NamedTuple):
    """A marker that was read and not placed. marker : identity; reason : in words; repeated : whether it is that one
    image shows it twice.
    """

    marker: int
    reason: str
    repeated: bool = False


class ReadMarkers(NamedTuple):
    """Markers whose corners are known to a pixel or so: as a reader saw them, or where they are expected.

    marker : (m,) identities; corners : (m, 4, 2) px; left_out : those that are not to be placed
    """

    marker: Integers
    corners: Floats
    left_out: Sequence[ExcludedMarker] = ()


@lru_cache
def opencv_detector(dictionary_name: str, numbers: tuple[int, ...] = ()) -> cv2.aruco.ArucoDetector:
    """OpenCV detector (cv2.aruco.ArucoDetector) of a dictionary.

    Its name is OpenCV's; corners are to whole pixels.
    numbers : identities that are looked for, whose places in `numbers` the detector returns; all where it is empty
    """
    dictionary, parameters = (
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary_name)),
        cv2.aruco.DetectorParameters(),
    )
    if numbers:
        codes = np.ascontiguousarray(dictionary.bytesList[list(numbers)])
        dictionary = cv2.aruco.Dictionary(codes, dictionary.markerSize, dictionary.maxCorrectionBits)
    parameters.perspectiveRemovePixelPerCell = CELL_PIXELS
    parameters.minMarkerDistanceRate = SAME_MARKER
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def read_marker_ids(image: Pixels, dictionary_name: str) -> list[int]:
    """Identities of a dictionary's markers that OpenCV reads in an image (height, width) uint8, in the order read."""
    ids = opencv_detector(dictionary_name).detectMarkers(image)[1]
    return [] if ids is None else [int(number) for number in ids.ravel()]


def read_markers(image: Pixels, marker_map: MarkerMap) -> ReadMarkers:
    """Read the markers of a rig in a whole image (height, width) uint8.

    Repeated ones are excluded.
    """
    image = np.ascontiguousarray(image)
    found: dict[int, list[Floats]] = {}
    for name in dict.fromkeys(marker_map.dictionary):
        numbers = tuple(number for number, other in zip(marker_map.id.tolist(), marker_map.dictionary) if other == name)
        quads, places, _ = opencv_detector(name, numbers).detectMarkers(image)
        for place, quad in zip([] if places is None else places.ravel().tolist(), quads):
            found.setdefault(numbers[int(place)], []).append(quad[0])
    left_out = [
        ExcludedMarker(number, f"seen {len(found.pop(number))} times in one image", True)
        for number in [number for number, quads in found.items() if len(quads) > 1]
    ]
    numbers_read = sorted(found)
    corners = np.array([found[number][0] for number in numbers_read], float).reshape(-1, 4, 2)
    return ReadMarkers(np.array(numbers_read, int), corners, left_out)


ITERATIONS = 25
ROOM = 6.0  # px around a marker that its blur may take
REACH = 3.0  # px from where the reader or a prediction puts them within which the sides of a marker are looked for
SMALLEST_CELL = 2.5  # px across, below which cells run together
CORRECTED = 25  # cells of which a reader would correct one
BEND = 0.02  # of a marker's side, that a lens may bend it by
WANDER = 1.5  # cells; a fit that ends farther from where the reader saw the corner is of something else
LEAST_WANDER = 2.0  # px; so far a fit of the smallest marker may end
EXPECTED_REACH = 6.0  # px, likewise, from where a pose that is expected puts them
AROUND = 0.5  # of a marker's extent, to each side of where it is expected and not read, that is searched for any other
BELIEVED = 0.5  # share of a body's markers that must be read where they are expected
MISFIT = 0.12  # of the contrast; residuals above it are no image of this marker
COVERED = 0.3  # share of pixels that are no image of this marker, from which it is not trusted
LEAST_CONTRAST = 6.0  # standard deviations of the noise
_NEXT = [1, 2, 3, 0]
_UNREAD = "its bits cannot be read at the expected place"
_REASONS = {
    square_gauss_newton_steps.NO_PIXELS: "too few pixels",
    square_gauss_newton_steps.SINGULAR: "its corners are not determined",
    square_gauss_newton_steps.WANDERED: "the fit turned over",
    square_gauss_newton_steps.NO_CONTRAST: "white is no brighter than black",
    square_gauss_newton_steps.UNSETTLED: "the fit did not settle",
    square_gauss_newton_steps.NOT_READ: _UNREAD,
}


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """What one image shows.

    marker : (m,) identities; corners : (m, 4, 2) px, OpenCV's pixel centres and corner order
    covariance : (m, 8, 8) px^2, of u0 v0 u1 v1 ..; blur : (m,) px, edge width, the pixel's own included
    noise : (m,) grey levels, standard deviation of what the fit leaves; contrast : (m,) grey levels
    left_out : markers that were read and not placed
    """

    marker: Integers
    corners: Floats
    covariance: Floats
    blur: Floats
    noise: Floats
    contrast: Floats
    left_out: tuple[ExcludedMarker, ...]

    @property
    def read(self) -> ReadMarkers:
        """The same as markers to be placed once more."""
        return ReadMarkers(self.marker, self.corners, self.left_out)

    def take(self, index: Integers) -> Detection:
        """The same with only the markers of an index or mask (m,)."""
        return Detection(
            self.marker[index],
            self.corners[index],
            self.covariance[index],
            self.blur[index],
            self.noise[index],
            self.contrast[index],
            self.left_out,
        )


def grey_image_at_full_depth(image: Pixels) -> Floats:
    """Grey image (height, width) at full depth, of an image as cv2 reads it.

    In 255ths: uint8, or float32 of 16 bit.
    Raises ValueError for an image that is not grey or colour, or not of 8 or 16 bit.
    """
    if image.ndim == 3 and image.shape[2] in (3, 4):
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY)
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"expected a grey or colour image of 8 or 16 bit, got {image.dtype} {image.shape}")
    return cast(Floats, image if image.dtype == np.uint8 else image.astype(np.float32) / 257)


def grey_images_for_reader_and_fit(image: Pixels) -> tuple[Floats, Floats]:
    """Grey images (height, width) for the reader and for the fit.

    8 bit for the reader, and at full depth for the fit.

    Of an image of 16 bit, the reader's is stretched to its bright parts. Raises as `grey_image_at_full_depth`
    """
    full = grey_image_at_full_depth(image)
    if full.dtype == np.uint8:
        return full, full
    top = max(float(np.percentile(full, 99.9)), 1e-3)
    return cast(Floats, np.clip(full * (255 / top), 0, 255).astype(np.uint8)), full


def detect_markers(
    image: Pixels,
    camera: Camera,
    marker_map: MarkerMap,
    spread: EdgeSpread = PLAIN_EDGE_SPREAD,
    T_base_platform: RigidTransform | None = None,
    search_for_others: bool = False,
) -> Detection:
    """Detection of all markers of a rig in one image, with their fitted corners.

    image : as cv2.imread(path, cv2.IMREAD_UNCHANGED) gives it; camera : Camera that took it, whose lens bends the edges
    marker_map : MarkerMap; other identities are passed over; spread : Spread of the camera's edges
    T_base_platform : the pose expected (from the command, or the frame before), or None. Then only the places are read
    where markers ought to be; where fewer than BELIEVED of a body's show their bits, the whole image is searched after
    all
    search_for_others : whether it is also searched where, instead of one that is not read, any other marker is:
        something is not as stated
    Returns Detection
    """
    if T_base_platform is not None:
        rows, places = expected_marker_rows_and_corners_in_image(camera, T_base_platform, marker_map)
        found = fit_read_markers(
            grey_image_at_full_depth(image),
            camera,
            marker_map,
            ReadMarkers(marker_map.id[rows], places),
            spread,
            EXPECTED_REACH,
            verify=True,
        )
        on, read = (
            marker_map.on_platform[rows],
            np.isin(marker_map.id[rows], [*found.marker, *(one.marker for one in found.left_out)]),
        )
        if (
            len(rows)
            and all(read[body].sum() >= BELIEVED * body.sum() for body in (on, ~on))
            and not (search_for_others and _others(image, marker_map, rows[~read], places[~read]))
        ):
            return found
    eight, full = grey_images_for_reader_and_fit(image)
    return fit_read_markers(full, camera, marker_map, read_markers(eight, marker_map), spread)


def _others(image: Pixels, marker_map: MarkerMap, rows: Integers, places: Floats) -> bool:
    """Whether any marker is read around places (m, 4, 2) px where those of rows (m,) were not: another, turned, or a
    little way off.
    """
    for row, quad in zip(rows, places):
        around = AROUND * np.ptp(quad, axis=0).max()
        (x0, y0), (x1, y1) = (
            np.maximum(quad.min(axis=0) - around, 0).astype(int),
            (quad.max(axis=0) + around).astype(int) + 1,
        )
        quads, ids, _ = opencv_detector(marker_map.dictionary[row]).detectMarkers(
            np.ascontiguousarray(grey_images_for_reader_and_fit(image[y0:y1, x0:x1])[0])
        )
        middle, side = quad.mean(axis=0) - [x0, y0], np.linalg.norm(quad - quad[_NEXT], axis=1).max()
        if ids is not None and any(np.linalg.norm(other[0].mean(axis=0) - middle) < side / 2 for other in quads):
            return True
    return False


def fit_read_markers(
    full: Floats,
    camera: Camera,
    marker_map: MarkerMap,
    read: ReadMarkers,
    spread: EdgeSpread = PLAIN_EDGE_SPREAD,
    search_distance: float = REACH,
    verify: bool = False,
    profile: Floats | None = None,
) -> Detection:
    """Fit the squares of markers that were read in an image.

    Their Detection, corners with covariance.
    full : (height, width) in 255ths of white; spread : Spread of the camera's edges
    search_distance : px that the sides may be away from the guess; 0 for one that is better than what profiles across
        them show
    verify : whether a marker's bits are read before it is believed to be there; where they are not, nothing is said of
        it
    profile : see vision.corners.edge_spread_function, added to
    """
    guess, numbers = np.asarray(read.corners, float).reshape(-1, 4, 2), np.asarray(read.marker, int)
    rows = marker_map.rows(numbers) if len(numbers) else np.zeros(0, int)
    patterns = [_pattern(marker_map.dictionary[row], number) for row, number in zip(rows.tolist(), numbers.tolist())]
    sizes = np.array([len(cells) for cells, _ in patterns], int)
    manner = square_fit.FitSettings(
        float(search_distance), 0 if verify else -1, ITERATIONS, spread.tables, LEVELS, spread.width
    )
    parts, left_out = [], list(read.left_out)
    for size in np.unique(sizes):
        index = np.flatnonzero(sizes == size)
        margin = marker_map.margin[rows[index]] / marker_map.side[rows[index]] * (size - 2)
        cells, outlooks = (np.array([patterns[i][k] for i in index]) for k in (0, 1))
        printed = _Printed(cells, outlooks, margin)
        manner = manner._replace(wrong=(int(size) - 2) ** 2 // CORRECTED if verify else -1)
        squares = _cut_out(full, camera, guess[index], printed, spread, search_distance)
        fits = _fit(squares, guess[index], manner, NO_PROFILE if profile is None else profile)
        reasons = _reasons(fits, guess[index], int(size))
        good = np.array([not reason for reason in reasons], bool)
        left_out += [
            ExcludedMarker(int(numbers[i]), reason) for i, reason in zip(index, reasons) if reason and reason != _UNREAD
        ]
        parts.append(
            (
                numbers[index[good]],
                fits.corners[good],
                fits.covariances[good],
                fits.width[good],
                fits.noise[good],
                fits.contrast[good],
            )
        )
    if not parts:
        empty = np.zeros(0)
        return Detection(
            np.zeros(0, int), np.zeros((0, 4, 2)), np.zeros((0, 8, 8)), empty, empty, empty, tuple(left_out)
        )
    numbers, corners, covariance, blur, noise, contrast = (np.concatenate(column) for column in zip(*parts))
    return Detection(numbers, corners, covariance, blur, noise, contrast, tuple(left_out)).take(
        np.argsort(numbers, kind="stable")
    )


class _Printed(NamedTuple):
    """What m markers of one size look like: cells and outlooks as in square.Squares, margins (m,) in cells."""

    cells: Floats
    outlooks: Floats
    margins: Floats


def _cut_out(
    full: Floats, camera: Camera, quads: Floats, printed: _Printed, spread: EdgeSpread, reach: float
) -> square_fit.Squares:
    """square.Squares of quads (m, 4, 2) px of one size."""
    height, width = full.shape
    sides_px = np.linalg.norm(quads[:, _NEXT] - quads, axis=2)
    centres = local_lens_and_fit_start.local_coordinate_origins_and_scales(quads)
    polynomials = np.empty((len(quads), 2, local_lens_and_fit_start.TERMS))
    local_lens_and_fit_start.fill_local_lens_polynomials(
        local_lens_and_fit_start.ideal_coordinate_table(camera), centres, polynomials
    )
    room = ROOM + reach + BEND * sides_px.max(axis=1)[:, None]
    low = np.clip(np.floor(quads.min(axis=1) - room), 0, [width, height]).astype(int)
    high = np.clip(np.ceil(quads.max(axis=1) + room) + 1, low, [width, height]).astype(int)
    boxes = np.concatenate([low, high], axis=1)
    starts = np.concatenate([[0], np.cumsum((high - low).prod(axis=1))])
    pixels = np.empty(starts[-1], np.float32)
    local_lens_and_fit_start.copy_image_boxes(full, boxes, starts, pixels)
    along = quads[:, _NEXT] - quads
    axes = np.stack([along[:, 0] - along[:, 2], along[:, 1] - along[:, 3]], axis=1)  # the marker's X and Y in the image
    directions = spread.rows(
        np.arctan2(axes[:, ::-1, 0], -axes[:, ::-1, 1])
    )  # an X edge lies along Y, its normal across
    return square_fit.Squares(
        pixels, starts, boxes, polynomials, centres, printed.cells, printed.outlooks, printed.margins, directions
    )


def _fit(
    squares: square_fit.Squares, quads: Floats, manner: square_fit.FitSettings, profile: Floats
) -> square_fit.Fits:
    """square.Fits of Squares, from quads (m, 4, 2) px on; profile added to."""
    m = len(quads)
    noise, contrast, used, doubted, width, steps = np.zeros((6, m))
    fits = square_fit.Fits(
        quads.copy(),
        np.zeros((m, 4, 2)),
        np.zeros((m, 8, 8)),
        noise,
        contrast,
        used,
        doubted,
        width,
        steps,
        np.zeros(m, np.int64),
        profile,
    )
    square_fit.fit_squares(squares, manner, fits)
    return fits


def _reasons(fits: square_fit.Fits, quads: Floats, size: int) -> list[str]:
    """Why each of the Fits is left out, or "" where it is not. quads : (m, 4, 2) px, where they were read;
    size : cells, white ring and all.
    """
    sides_px = np.linalg.norm(quads[:, _NEXT] - quads, axis=2)
    wandered = np.abs(fits.corners - quads).max(axis=(1, 2)) > np.maximum(
        WANDER * sides_px.max(axis=1) / (size - 2), LEAST_WANDER
    )
    columns = fits.status, sides_px.min(axis=1) / (size - 2), wandered, fits.noise, fits.contrast, fits.doubted
    return [_reason(*row) for row in zip(*(column.tolist() for column in columns))]


def _reason(status: int, cell: float, wandered: bool, noise: float, contrast: float, doubted: float) -> str:
    """Why a marker is left out, or "" where it is not."""
    if status == square_gauss_newton_steps.NOT_READ:
        return _UNREAD
    if cell < SMALLEST_CELL:
        return f"too small: a cell is {cell:.1f} px"
    if status != square_gauss_newton_steps.OK:
        return _REASONS[status]
    if contrast < LEAST_CONTRAST * noise:
        return (
            f"contrast {contrast:.0f} is lost in noise {noise:.1f}"
            if noise < MISFIT * 255
            else "covered or not this marker"
        )
    if doubted > COVERED:
        return f"covered or not this marker: {doubted:.0%} of its pixels disagree"
    if noise > MISFIT * contrast:
        return f"covered or not this marker: the fit leaves {noise / contrast:.0%} of the contrast"
    return "the fit left the place where it was read" if wandered else ""


@cache
def _pattern(name: str, number: int) -> tuple[Floats, Floats]:
    cells = marker_cells(name, number)
    return cells, edge_pixels.pixel_edge_kinds(cells)
