"""Image -> marker corners with covariance: OpenCV finds and reads the markers, the fit of the whole square places them."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from vision import lens, square
from vision.targets import marker_cells

FIRST_BLUR = 0.8  # px
ITERATIONS = 25
SMALLEST_CELL = 2.5  # px across, below which cells run together
WANDER = 1.5  # cells; a fit that ends farther from where the reader saw the corner is of something else
MISFIT = 0.12  # of the contrast; residuals above it are no image of this marker
COVERED = 0.3  # share of pixels that are no image of this marker, from which it is not trusted
LEAST_CONTRAST = 6.0  # standard deviations of the noise
_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
_REASONS = {square.NO_PIXELS: "too few pixels", square.SINGULAR: "its corners are not determined", square.WANDERED: "the fit turned over",
            square.NO_CONTRAST: "white is no brighter than black", square.UNSETTLED: "the fit did not settle"}


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """What one image shows.

    marker : (m,) identities; corners : (m, 4, 2) px, OpenCV's pixel centres and corner order
    covariance : (m, 8, 8) px^2, of u0 v0 u1 v1 ..; blur : (m,) px, the pixel's own width included
    noise : (m,) grey levels, standard deviation of what the fit leaves; contrast : (m,) grey levels
    left_out : (identity, reason) of markers that were read and not placed
    """

    marker: np.ndarray
    corners: np.ndarray
    covariance: np.ndarray
    blur: np.ndarray
    noise: np.ndarray
    contrast: np.ndarray
    left_out: tuple[tuple[int, str], ...]


def grey(image):
    """(height, width) uint8 for the reader and float32 for the fit, of an image as cv2 reads it: 8 or 16 bit, grey or colour.

    Raises ValueError for any other kind.
    """
    if image.ndim == 3 and image.shape[2] in (3, 4):
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY)
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"expected a grey or colour image of 8 or 16 bit, got {image.dtype} {image.shape}")
    if image.dtype == np.uint8:
        return image, image.astype(np.float32)
    full = image.astype(np.float32) / 257
    top = max(float(np.percentile(full, 99.9)), 1e-3)
    return np.clip(full * (255 / top), 0, 255).astype(np.uint8), full


@lru_cache
def _detector(name):
    parameters = cv2.aruco.DetectorParameters()
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)), parameters)


def detect(image, camera, marker_map):
    """All markers of a rig in one image.

    image : as cv2.imread(path, cv2.IMREAD_UNCHANGED) gives it; camera : Camera that took it, whose lens bends the edges
    marker_map : MarkerMap; other identities are passed over
    Returns Detection
    """
    eight, full = grey(image)
    found, left_out = {}, []
    for name in dict.fromkeys(marker_map.dictionary):
        corners, ids, _ = _detector(name).detectMarkers(eight)
        ids = [] if ids is None else ids.ravel().tolist()
        for number, quad in zip(ids, corners):
            row = marker_map.rows([number])[0]
            if row < 0 or marker_map.dictionary[row] != name:
                continue
            found.setdefault(int(number), []).append(np.asarray(quad, float).reshape(4, 2))
    for number in [number for number, quads in found.items() if len(quads) > 1]:
        left_out.append((number, f"seen {len(found.pop(number))} times in one image"))
    numbers = sorted(found)
    return place(full, camera, marker_map, numbers, np.array([found[k][0] for k in numbers]).reshape(-1, 4, 2), left_out)


def place(full, camera, marker_map, numbers, guess, left_out=()):
    """Detection of markers (m identities) whose corners (m, 4, 2) px are known to a pixel or so. full : float32 image."""
    guess = np.asarray(guess, float)
    rows = marker_map.rows(np.array(numbers, int)) if len(numbers) else np.zeros(0, int)
    out, kept, left_out = [], [], list(left_out)
    for bits in sorted({len(marker_cells(marker_map.dictionary[row], numbers[i])) for i, row in enumerate(rows)}):
        index = [i for i, row in enumerate(rows) if len(marker_cells(marker_map.dictionary[row], numbers[i])) == bits]
        n = bits - 4
        cells = np.array([marker_cells(marker_map.dictionary[rows[i]], numbers[i]) for i in index])
        margin = np.array([marker_map.margin[rows[i]] / marker_map.side[rows[i]] * (n + 2) for i in index])
        for i, result in zip(index, _fit(full, camera, guess[index], cells, n, margin)):
            if isinstance(result, str):
                left_out.append((int(numbers[i]), result))
            else:
                kept.append(int(numbers[i]))
                out.append(result)
    order = np.argsort(kept, kind="stable")
    columns = [np.array([out[i][k] for i in order]) for k in range(5)]
    return Detection(np.array(kept, int)[order], columns[0].reshape(-1, 4, 2), columns[1].reshape(-1, 8, 8), *columns[2:], tuple(left_out))


def _fit(full, camera, quads, cells, n, margin):
    """(corners, covariance, blur, noise, contrast) or a reason, for each quad (m, 4, 2) px of one size of marker."""
    m = len(quads)
    height, width = full.shape
    sides = np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2)
    centre = quads.mean(axis=1)
    scale = np.abs(quads - centre[:, None]).max(axis=(1, 2))
    polynomials, focal = _lens_polynomials(camera, centre, scale)
    local = (quads - centre[:, None]) / scale[:, None, None]
    ideal = np.einsum("mci,mki->mkc", polynomials, _powers(local))
    goal = np.array([[-1, -1], [n + 1, -1], [n + 1, n + 1], [-1, n + 1.0]])
    G = np.array([_homography(points, goal) for points in ideal])
    reach = sides.max(axis=1) / (n + 2) + 4
    low = np.maximum(np.floor(quads.min(axis=1) - reach[:, None]), 0).astype(int)
    high = np.minimum(np.ceil(quads.max(axis=1) + reach[:, None]) + 1, [width, height]).astype(int)
    blur, results = np.full(m, FIRST_BLUR), np.zeros((m, 6))
    covariances, status = np.zeros((m, square.UNKNOWNS, square.UNKNOWNS)), np.zeros(m, np.int64)
    centres = np.concatenate([centre, scale[:, None]], axis=1)
    square.fit_squares(full, np.concatenate([low, high], axis=1), polynomials, centres, cells, n, margin, G, blur, ITERATIONS, results,
                       covariances, status)
    for k in range(m):
        yield _judge(k, camera, quads, sides, centres, focal, goal, G, blur, results, covariances, status, n)


def _judge(k, camera, quads, sides, centres, focal, goal, G, blur, results, covariances, status, n):
    cell = sides[k].min() / (n + 2)
    if cell < SMALLEST_CELL:
        return f"too small: a cell is {cell:.1f} px"
    if status[k] != square.OK:
        return _REASONS[status[k]]
    noise, contrast, doubted = results[k, :2].tolist() + [results[k, 3]]
    if contrast < LEAST_CONTRAST * noise:
        return f"contrast {contrast:.0f} is lost in noise {noise:.1f}" if noise < MISFIT * 255 else "covered or not this marker"
    if doubted > COVERED:
        return f"covered or not this marker: {doubted:.0%} of its pixels do not fit"
    if noise > MISFIT * contrast:
        return f"covered or not this marker: the fit leaves {noise / contrast:.0%} of the contrast"
    local, to_homography = _corners(G[k], goal)
    scale = centres[k, 2]
    points = np.concatenate([(local * scale + focal[k, 1]) / focal[k, 0], np.ones((4, 1))], axis=1)
    corners, J_point, _ = lens.project_jacobian(points, camera.matrix, camera.distortion)
    if np.abs(corners - quads[k]).max() > max(WANDER * sides[k].max() / (n + 2), 2.0):
        return "the fit left the place where it was read"
    J = np.zeros((8, 8))
    for c in range(4):
        J[2 * c : 2 * c + 2] = J_point[c, :, :2] @ (to_homography[c] * scale / focal[k, 0][:, None])
    return corners, J @ covariances[k, :8, :8] @ J.T, blur[k], noise, contrast


def _powers(local):
    """(..., 10) monomials up to the third degree of local coordinates (..., 2), in the order the fit takes them."""
    u, v = local[..., 0], local[..., 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3], axis=-1)


_NODES = np.stack(np.meshgrid(*[1.6 * np.cos(np.pi * (np.arange(5) + 0.5) / 5)] * 2), axis=-1).reshape(-1, 2)
_TO_POLYNOMIAL = np.linalg.pinv(_powers(_NODES))


def _lens_polynomials(camera, centre, scale):
    """(m, 2, 10) cubics from local pixels to local ideal coordinates, and (m, 2, 2) focal length and offset that undo these.

    Local pixel: (pixel - centre) / scale. Local ideal: (ideal * focal - offset) / scale.
    """
    uv = centre[:, None] + scale[:, None, None] * _NODES
    ideal = lens.undistort(np.concatenate([uv, centre[:, None]], axis=1), camera.matrix, camera.distortion)
    f = np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
    offset = ideal[:, -1] * f
    local = (ideal[:, :-1] * f - offset[:, None]) / scale[:, None, None]
    return np.ascontiguousarray(np.einsum("ik,mkc->mci", _TO_POLYNOMIAL, local)), np.stack([np.broadcast_to(f, offset.shape), offset], axis=1)


def _homography(points, goal):
    """(3, 3) with last entry 1 that maps four points (4, 2) to goal (4, 2)."""
    A = np.zeros((8, 8))
    for i, ((x, y), (X, Y)) in enumerate(zip(points, goal)):
        A[2 * i] = x, y, 1, 0, 0, 0, -X * x, -X * y
        A[2 * i + 1] = 0, 0, 0, x, y, 1, -Y * x, -Y * y
    return np.append(np.linalg.solve(A, goal.ravel()), 1.0).reshape(3, 3)


def _corners(G, goal):
    """Local ideal coordinates (4, 2) of the square's corners and their Jacobian (4, 2, 8) to the homography's entries."""
    back = np.linalg.inv(G)
    h = np.concatenate([goal, np.ones((4, 1))], axis=1) @ back.T
    local = h[:, :2] / h[:, 2:]
    J = np.empty((4, 2, 8))
    for c in range(4):
        x, y = local[c]
        X, Y = goal[c]
        w = G[2, 0] * x + G[2, 1] * y + G[2, 2]
        to_cells = np.array([[x, y, 1, 0, 0, 0, -X * x, -X * y], [0, 0, 0, x, y, 1, -Y * x, -Y * y]]) / w
        slope = np.array([[G[0, 0] - X * G[2, 0], G[0, 1] - X * G[2, 1]], [G[1, 0] - Y * G[2, 0], G[1, 1] - Y * G[2, 1]]]) / w
        J[c] = -np.linalg.solve(slope, to_cells)
    return local, J
