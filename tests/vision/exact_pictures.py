"""Exact pictures of markers by brute force: many samples to the pixel, no renderer and no code of ours in between."""

from functools import cache

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from rig.model.design import Camera
from rig.model.pose import pose
from vision.marker_corner_prediction import marker_cells

SIZE = 180


def camera(distortion=(0.0, 0, 0, 0, 0), size=SIZE):
    """A camera whose image is just large enough for one marker."""
    return Camera(
        "c",
        size,
        size,
        [[900.0, 0, size / 2], [0, 900, size / 2], [0, 0, 1]],
        np.array(distortion),
        pose([0, 0, 0], [0, 0, 0]),
    )


def picture(
    corners,
    dictionary,
    number,
    blur=0.6,
    white=190.0,
    black=20.0,
    beyond=70.0,
    margin=0.9,
    samples=12,
    size=SIZE,
    sharp=False,
):
    """(size, size) float grey picture of a flat marker with corners (4, 2) px, no lens; margin : cells of white around
    it.

    sharp : each of the samples x samples of a pixel sees one point, as a ray caster's do, and not its share of each
        cell
    """
    cells = marker_cells(dictionary, number)
    n = len(cells) - 4
    square = np.array([[-1, -1], [n + 1, -1], [n + 1, n + 1], [-1, n + 1]], np.float32)
    H = cv2.getPerspectiveTransform((corners - corners[0]).astype(np.float32), square).astype(float)
    A = np.zeros((8, 8))
    for i, ((x, y), (X, Y)) in enumerate(zip(corners, square)):  # in double precision
        A[2 * i], A[2 * i + 1] = (x, y, 1, 0, 0, 0, -X * x, -X * y), (0, 0, 0, x, y, 1, -Y * x, -Y * y)
    H = np.append(np.linalg.solve(A, square.astype(float).ravel()), 1).reshape(3, 3)
    grid = (np.arange(size * samples) + 0.5) / samples - 0.5
    ends = n + 1 + margin, -1 - margin
    columns, rows = _reach(H, np.array([(a, b, 1) for a in ends for b in ends]), size, samples)
    u, v = np.meshgrid(grid[columns], grid[rows])
    w = H[2, 0] * u + H[2, 1] * v + H[2, 2]
    X, Y = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w, (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
    gx, gy = (
        np.hypot(H[k, 0] - Z * H[2, 0], H[k, 1] - Z * H[2, 1]) / w / samples for k, Z in ((0, X), (1, Y))
    )  # of a sample
    if sharp:
        gx, gy = 1e-9, 1e-9
    paper = (
        _beyond(X + 1 + margin, gx)
        * _beyond(n + 1 + margin - X, gx)
        * _beyond(Y + 1 + margin, gy)
        * _beyond(n + 1 + margin - Y, gy)
        * (w > 0)
    )
    i, j = np.rint(X), np.rint(Y)  # the lines nearest to the sample, and how much of it lies beyond them
    right, below = _beyond(X - i, gx), _beyond(Y - j, gy)
    (left, past), (top, under) = (np.clip(np.stack([k + 1, k + 2]).astype(int), 0, n + 3) for k in (i, j))
    share = (1 - below) * ((1 - right) * cells[top, left] + right * cells[top, past]) + below * (
        (1 - right) * cells[under, left] + right * cells[under, past]
    )
    grey = np.full((size * samples, size * samples), beyond)
    grey[rows, columns] += paper * (black + (white - black) * share - beyond)
    pixels = _blurred_means(blur, samples, size)
    return pixels @ grey @ pixels.T


def _reach(H, paper, size, samples):
    """Slices of the samples, of columns and of rows, beyond which there is no paper; all of them where its corners
    (4, 3) are not all before the camera.
    """
    at = paper @ np.linalg.inv(H).T
    if (at[:, 2] <= 0).any():
        return slice(None), slice(None)
    at = at[:, :2] / at[:, 2:]
    low, high = np.floor(at.min(axis=0)) - 1, np.ceil(at.max(axis=0)) + 2
    return tuple(slice(*(samples * np.clip([a, b], 0, size).astype(int))) for a, b in zip(low, high))


@cache
def _blurred_means(blur, samples, size):
    """(size, size * samples) what blurs samples along an axis and takes the mean of those of each pixel."""
    one = gaussian_filter1d(np.eye(size * samples), blur * samples, axis=0, truncate=6)
    return one.reshape(size, samples, -1).mean(axis=1)


def _beyond(distance, width):
    """Share of a sample on the positive side of a line at a signed distance: a ramp with the variance that the sample's
    own square has.
    """
    return np.clip(distance / width + 0.5, 0, 1)


def quad(rng, side=55.0, tilt=0.0, size=SIZE):
    """(4, 2) px corners of a marker of about that side, turned at random and foreshortened by tilt (rad)."""
    turn, axis = rng.uniform(0, 2 * np.pi, 2)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    along = np.array([[np.cos(axis), -np.sin(axis)], [np.sin(axis), np.cos(axis)]])
    squash = along @ np.diag([1, np.cos(tilt)]) @ along.T
    corners = side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]]) @ spin.T @ squash.T
    depth = 1 + 0.1 * np.sin(tilt) * (corners @ along[:, 1]) / side
    return corners / depth[:, None] + size / 2 + rng.uniform(-0.5, 0.5, 2)
