"""Corners of a marker by straight lines through its four edges: nothing of ours, for pictures without noise."""

import numpy as np
from scipy.ndimage import map_coordinates

from vision import opencv_lens_model as lens


def edge_corners(image, corners, camera, reach=4.0, along=(0.2, 0.8), samples=41):
    """(4, 2) px corners of a marker known to a pixel or so, or None where an edge has no room.

    Each edge is sampled across at many places along its middle part; the place where the brightness has made half its
    step is the mean of the profile's slope; through these places, the lens taken out, goes a line; neighbouring lines
    meet.
    """
    centre = corners.mean(axis=0)
    lines = []
    offsets = np.linspace(-reach, reach, 161)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        unit = (b - a) / np.linalg.norm(b - a)
        normal = np.array([unit[1], -unit[0]])
        normal *= np.sign(normal @ ((a + b) / 2 - centre))
        starts = a + np.linspace(*along, samples)[:, None] * (b - a)
        places = starts[:, None] + offsets[None, :, None] * normal
        profile = map_coordinates(image, [places[..., 1], places[..., 0]], order=3, mode="nearest")
        slope = np.diff(profile, axis=1)
        low, high = profile[:, :12].mean(axis=1), profile[:, -12:].mean(axis=1)
        if ((high - low) < 0.05 * np.ptp(image)).any():
            return None
        middle = (offsets[1:] + offsets[:-1]) / 2
        crossing = (slope * middle).sum(axis=1) / slope.sum(axis=1)
        points = starts + crossing[:, None] * normal
        ideal = lens.undistort(points, camera.matrix, camera.distortion)
        mean = ideal.mean(axis=0)
        direction = np.linalg.svd(ideal - mean)[2][0]
        lines.append((mean, direction))
    found = []
    for k in range(4):
        (p, d), (q, e) = lines[k - 1], lines[k]
        s = np.linalg.solve(np.stack([d, -e], axis=1), q - p)[0]
        found.append(p + s * d)
    return lens.project(np.c_[np.array(found), np.ones(4)], camera.matrix, camera.distortion)
