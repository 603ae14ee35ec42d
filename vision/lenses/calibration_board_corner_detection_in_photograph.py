"""Detection of a calibration board's corners in a photograph.

Of a calibration board, with covariance: those of its markers, and chessboard corners.

The image of a crossing under Gaussian blur (the pixel's own width included) is the chance that a normal draw about the
pixel falls into one of the two white quadrants: a bivariate normal of the distances to the two edges, correlated by
their angle.
Fitted by robust Gauss-Newton: the crossing (2), both directions (2), the blur (1), black and white, each a plane (6),
in coordinates in which the lens is taken out, so that edges are straight.
Source: bivariate normal, Drezner and Wesolowsky 1990; corner accuracy from edges, Rohr 1992.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import ndtr

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.model.calibration_board_layout_and_description_parsing import Board
from rig.model.design import Camera
from vision import opencv_lens_model as lens
from vision.corners.marker_detection_and_corner_fit import detect_markers, grey_images_for_reader_and_fit
from vision.marker_corner_prediction import MarkerMap

ITERATIONS = 40
SETTLING = 8  # iterations
SETTLED = 5e-4  # px
STRIP = 4.0  # blur widths on either side of an edge that are looked at
ALONG = 0.42  # of a square, how far along the edges from their crossing
TRUSTED = 4.0  # robust standard deviations; a pixel farther off counts less
LEAST_PIXELS = 60
LEAST_CONTRAST = 8.0  # times the noise
MISFIT = 0.12  # of the contrast
DOUBTED = 0.3  # share of pixels that count less
WANDER = 0.15  # of a square
LEAST_WANDER = 1.5  # px
STEEPEST = 0.2  # sine of the angle between both edges in the image
FINEST = 0.3  # grey levels; a robust scale below this is rounding
FAINTEST = 1.0  # grey levels that white must be brighter than black
FIRST_BLUR, LEAST_BLUR, MOST_BLUR = 1.0, 0.3, 5.0  # px
STEP_PX, STEP_RAD, STEP_BLUR = 2.0, 0.1, 0.4  # px, rad, px: what one step changes at most
PLACE = 5  # unknowns of the crossing itself; those after it are of the light
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, eq=False)
class Junction:
    """uv : (2,) px; covariance : (2, 2) px^2; blur : px; noise, contrast : grey levels."""

    uv: Floats
    covariance: Floats
    blur: float
    noise: float
    contrast: float


class Share(NamedTuple):
    """White share (n,) of a crossing and its slopes (n,) by h, k and rho."""

    white: Floats
    by_h: Floats
    by_k: Floats
    by_rho: Floats


def edge_crossing_white_share(h: Floats, k: Floats, rho: float) -> Share:
    """White share at a crossing of two blurred edges.

    It is white where h and k have the same sign.
    h, k : (n,) distances to the edges in blur widths; rho : correlation, the cosine between the edges' normals
    """
    s = np.sqrt(1 - rho * rho)
    density = np.exp(-(h * h - 2 * rho * h * k + k * k) / (2 * s * s)) / (2 * np.pi * s)
    r = 0.5 * rho * (_NODES + 1)
    q = 1 - r * r
    inner = np.exp(-(h[:, None] ** 2 - 2 * r * h[:, None] * k[:, None] + k[:, None] ** 2) / (2 * q)) / np.sqrt(q)
    both = inner @ _WEIGHTS * rho / (4 * np.pi)
    H, K = ndtr(h), ndtr(k)
    dh = np.exp(-h * h / 2) / np.sqrt(2 * np.pi) * (2 * ndtr((k - rho * h) / s) - 1)
    dk = np.exp(-k * k / 2) / np.sqrt(2 * np.pi) * (2 * ndtr((h - rho * k) / s) - 1)
    return Share(H * K + (1 - H) * (1 - K) + 2 * both, dh, dk, 2 * density)


class Straight(NamedTuple):
    """A lens taken out and put back.

    ideal : function of pixels (n, 2) to coordinates (n, 2) px in which straight edges are straight
    pixel : function of one of these (2,) to its pixel (2,) and the Jacobian (2, 2) of that
    """

    ideal: Callable[[Floats], Floats]
    pixel: Callable[[Floats], tuple[Floats, Floats]]


class _Pixels(NamedTuple):
    """The pixels around a crossing: ideal (n, 2) px, the lens taken out; board (n, 2) squares from the guess; grey
    (n,); white as in `fit`.
    """

    ideal: Floats
    board: Floats
    grey: Pixels
    white: bool


class _Extent(NamedTuple):
    """size : px, a square's mean side in the image; clear : (2,) px beside the x line and the y line that no other edge
    comes into.
    """

    size: float
    clear: Floats


class _Linear(NamedTuple):
    """residual (n,) grey levels and Jacobian (n, 11) at a crossing p and light (6,) as they were guessed where there
    were none.
    """

    residual: Floats
    jacobian: Floats
    light: Floats


class _Settled(NamedTuple):
    """p : (5,) crossing px, directions of the board's x and y rad, blur px; light : (6,); information : (11, 11);
    weight, residual : (n,)
    scatter : grey levels, robust."""

    p: Floats
    light: Floats
    information: Floats
    weight: Floats
    residual: Floats
    scatter: float


def fit_chessboard_corner(
    image: Pixels, guess: Floats, axes: Floats, white: bool, straight: Straight, clear_width: float
) -> Junction | str:
    """Fitted chessboard corner (Junction).

    Or the reason (text) why none was found.
    image : (height, width) float; guess : (2,) px; axes : (2, 2) px per square, columns the board's x and y in the
        image
    white : whether the quadrant between both axes is white; straight : Straight; clear_width : of a square, what is
        clear beside an edge
    """
    corners = guess + ALONG * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ axes.T
    low, high = np.floor(corners.min(axis=0) - 2).astype(int), np.ceil(corners.max(axis=0) + 2).astype(int)
    if (low < 0).any() or high[0] >= image.shape[1] or high[1] >= image.shape[0]:
        return "too near the image's edge"
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    places = np.stack([x.ravel(), y.ravel()], axis=1).astype(float)
    pixels = _Pixels(straight.ideal(places), (places - guess) @ np.linalg.inv(axes).T, image[y, x].ravel(), white)
    origin, ends = straight.ideal(guess[None])[0], straight.ideal(guess + 0.2 * axes.T)
    angles = np.arctan2(*(ends - origin).T[::-1])
    sizes, sine = np.linalg.norm(axes, axis=0), abs(np.sin(angles[1] - angles[0]))
    if sine < STEEPEST:
        return "seen too obliquely"
    # board x's line is the edge at which y changes sign: its normal is that of the x direction
    settled = _settle(
        pixels, np.array([*origin, *angles, FIRST_BLUR]), _Extent(sizes.mean(), clear_width * sizes[::-1] * sine)
    )
    if isinstance(settled, str):
        return settled
    uv, back = straight.pixel(settled.p[:2])
    far = np.linalg.norm(np.linalg.solve(axes, uv - guess)) > max(WANDER, LEAST_WANDER / sizes.min())
    return _judged(settled, uv, back, far)


def _settle(pixels: _Pixels, p: Floats, extent: _Extent) -> _Settled | str:
    """Robust Gauss-Newton from p (5,) on; or the reason why it does not settle."""
    light, scatter = None, np.inf
    for iteration in range(ITERATIONS):
        linear = _linearise(pixels, p, light, extent)
        if isinstance(linear, str):
            return linear
        r, J, light = linear
        if iteration < SETTLING:  # afterwards it stands, so that the weights can settle too
            scatter = max(1.4826 * np.median(np.abs(r)), FINEST)
        weight = np.minimum(1, (TRUSTED * scatter / np.maximum(np.abs(r), 1e-9)) ** 2)
        A = J * weight[:, None]
        try:
            step = np.linalg.solve(A.T @ J, A.T @ r)
        except np.linalg.LinAlgError:
            return "not determined"
        limit = min(
            1.0,
            STEP_PX / max(np.abs(step[:2]).max(), 1e-9),
            STEP_RAD / max(np.abs(step[2:4]).max(), 1e-9),
            STEP_BLUR / max(abs(step[4]), 1e-9),
        )
        p = p + limit * step[:PLACE]
        p[4] = np.clip(p[4], LEAST_BLUR, MOST_BLUR)
        light = light + step[PLACE:]
        if np.abs(step[:2]).max() < SETTLED and iteration > 3:
            return _Settled(p, light, A.T @ J, weight, r, scatter)
    return "the fit did not settle"


def _linearise(pixels: _Pixels, p: Floats, light: Floats | None, extent: _Extent) -> _Linear | str:
    """The pixels near both edges of a crossing p (5,), linearised; or the reason why there are too few. light : (6,),
    or None to guess it.
    """
    d = pixels.ideal - p[:2]
    c, s = np.cos(p[2:4]), np.sin(p[2:4])
    across = d[:, 1:] * c - d[:, :1] * s  # (n, 2) px from the x line and from the y line
    along = d[:, :1] * c + d[:, 1:] * s
    strip = np.minimum(STRIP * p[4], extent.clear - 2.5 * p[4])
    if (strip < 1.5 * p[4]).any():
        return "too small"
    use = (np.abs(across) < strip).any(axis=1) & (np.abs(pixels.board) < ALONG).all(axis=1)
    if use.sum() < LEAST_PIXELS:
        return "too few pixels"
    # the y line's sign is turned so that both are positive in the quadrant between the axes
    turn = np.array([1.0, -1.0]) * np.sign(np.sin(p[3] - p[2]))
    h, k = (turn * across[use] / p[4]).T
    w, dh, dk, dr = edge_crossing_white_share(h, k, turn[0] * turn[1] * np.cos(p[3] - p[2]))
    if not pixels.white:
        w, dh, dk, dr = 1 - w, -dh, -dk, -dr
    grey, near = pixels.grey[use], d[use] / extent.size
    planes = np.stack([w, w * near[:, 0], w * near[:, 1], 1 - w, (1 - w) * near[:, 0], (1 - w) * near[:, 1]], axis=1)
    if light is None:
        light = np.linalg.lstsq(planes, grey, rcond=None)[0]
    if light[0] - light[3] < FAINTEST:
        return "white is no brighter than black"
    amplitude = light[0] - light[3] + near @ (light[1:3] - light[4:6])
    n1, n2 = turn[0] * np.array([-s[0], c[0]]) / p[4], turn[1] * np.array([-s[1], c[1]]) / p[4]
    J = np.empty((len(grey), PLACE + 6))
    J[:, :2] = -(dh[:, None] * n1 + dk[:, None] * n2)
    J[:, 2] = -dh * turn[0] * along[use, 0] / p[4] + dr * turn[0] * turn[1] * np.sin(p[3] - p[2])
    J[:, 3] = -dk * turn[1] * along[use, 1] / p[4] - dr * turn[0] * turn[1] * np.sin(p[3] - p[2])
    J[:, 4] = -(dh * h + dk * k) / p[4]
    J[:, :PLACE] *= amplitude[:, None]
    J[:, PLACE:] = planes
    return _Linear(grey - planes @ light, J, light)


def _judged(settled: _Settled, uv: Floats, back: Floats, far: bool) -> Junction | str:
    """Junction at uv (2,) px, or why it is none. back : (2, 2) px per px without the lens; far : whether it left where
    it was expected.
    """
    weight, r, scatter = settled.weight, settled.residual, settled.scatter
    contrast, noise = settled.light[0] - settled.light[3], np.sqrt((weight * r**2).sum() / max(weight.sum() - 11, 1))
    if contrast < LEAST_CONTRAST * scatter:
        return f"contrast {contrast:.0f} is lost in noise {scatter:.1f}"
    if noise > MISFIT * contrast or (weight < 1).mean() > DOUBTED:
        return f"covered or no corner of this board: the fit leaves {noise / contrast:.0%} of the contrast"
    if far:
        return "the fit left the place where it was expected"
    covariance = np.linalg.inv(settled.information)[:2, :2] * noise**2
    return Junction(uv, back @ covariance @ back.T, float(settled.p[4]), float(noise), float(contrast))


NEIGHBOURS = 4  # markers next to a chessboard corner from which it is guessed
NEIGHBOUR_DISTANCE = 1.6  # squares, the farthest that they are


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of a board in one photograph. corner : (n,) rows of Board.points; uv : (n, 2) px; covariance : (n, 2, 2)
    px^2
    left_out : (corner, reason) of those expected and not placed."""

    corner: Integers
    uv: Floats
    covariance: Floats
    left_out: tuple[tuple[int, str], ...]


def find_board_corners(image: Pixels, board: Board, camera: Camera) -> BoardView:
    """Find the corners of a board in an image as cv2 reads it, as a BoardView.
    camera : Camera whose lens bends the edges (no distortion for the first look)
    """
    if board.kind != "charuco":
        return _markers(image, board, camera)
    eight, full = grey_images_for_reader_and_fit(image)
    found, ids, _ = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    ).detectMarkers(eight)
    ids = np.zeros(0, int) if ids is None else ids.ravel()
    keep = [i for i, number in enumerate(ids) if number < len(board.places()) and (ids == number).sum() == 1]
    if not keep:
        return BoardView(np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2, 2)), ())
    quads = np.array([found[i].reshape(4, 2) for i in keep], float)
    numbers = ids[keep]
    corners, middles = board.marker_corners()[numbers, :, :2], board.places()[numbers]
    straight = _straight(camera)
    clear = board.margin / board.pitch
    rows, out, left_out = [], [], []
    for row, point in enumerate(board.points[:, :2]):
        distance = np.linalg.norm(middles - point, axis=1) / board.pitch
        near = [i for i in np.argsort(distance)[:NEIGHBOURS] if distance[i] < NEIGHBOUR_DISTANCE]
        if not near:
            continue
        H, _ = cv2.findHomography((corners[near].reshape(-1, 2) - point) / board.pitch, quads[near].reshape(-1, 2))
        if H is None:
            continue
        guess, slope = H[:2, 2] / H[2, 2], (H[:2, :2] - np.outer(H[:2, 2] / H[2, 2], H[2, :2])) / H[2, 2]
        column, line = np.round(point / board.pitch).astype(int)
        white = (column + line + (board.rows % 2 == 0 if board.legacy else 0)) % 2 == 1
        fitted = fit_chessboard_corner(full, guess, slope, white, straight, clear)
        if isinstance(fitted, str):
            left_out.append((row, fitted))
        else:
            rows.append(row)
            out.append(fitted)
    return BoardView(
        np.array(rows, int),
        np.array([one.uv for one in out]).reshape(-1, 2),
        np.array([one.covariance for one in out]).reshape(-1, 2, 2),
        tuple(left_out),
    )


def _markers(image: Pixels, board: Board, camera: Camera) -> BoardView:
    middles = np.pad(board.places() * [1, -1], ((0, 0), (0, 1)))
    map_ = MarkerMap(
        np.arange(len(middles)),
        np.zeros(len(middles), bool),
        RigidTransform.from_translation(middles),
        np.full(len(middles), board.side),
        np.full(len(middles), board.margin),
        [board.dictionary] * len(middles),
        ["board"] * len(middles),
        np.zeros(len(middles), int),
    )
    found = detect_markers(image, camera, map_)
    rows = (found.marker[:, None] * 4 + np.arange(4)).ravel()
    covariance = (
        np.array([found.covariance[:, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(4)])
        .reshape(4, -1, 2, 2)
        .swapaxes(0, 1)
    )
    return BoardView(
        rows,
        found.corners.reshape(-1, 2),
        covariance.reshape(-1, 2, 2),
        tuple((4 * one.marker, one.reason) for one in found.left_out),
    )


def _straight(camera: Camera) -> Straight:
    """Pixels to coordinates without the lens's distortion, px, and one of these back with its Jacobian."""
    K, D = camera.matrix, camera.distortion
    focal, centre = np.diag(K)[:2], K[:2, 2]
    if not np.any(D):
        return Straight(lambda uv: uv, lambda xy: (xy, np.eye(2)))

    def back(xy: Floats) -> tuple[Floats, Floats]:
        uv, J, _ = lens.projected_pixels_and_jacobians(np.append((xy - centre) / focal, 1.0), K, D)
        return uv, J[:, :2] / focal

    return Straight(lambda uv: lens.undistort(uv, K, D) * focal + centre, back)
