"""Where two printed edges cross: the corner of a chessboard, fitted to its pixels along both edges.

The image of a crossing under Gaussian blur (the pixel's own width included) is the chance that a normal draw about the pixel
falls into one of the two white quadrants: a bivariate normal of the distances to the two edges, correlated by their angle.
Fitted by robust Gauss-Newton: the crossing (2), both directions (2), the blur (1), black and white, each a plane (6), in
coordinates in which the lens is taken out, so that edges are straight.
Source: bivariate normal, Drezner and Wesolowsky 1990; corner accuracy from edges, Rohr 1992.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

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
FIRST_BLUR, LEAST_BLUR, MOST_BLUR = 1.0, 0.3, 5.0  # px
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, eq=False)
class Junction:
    """uv : (2,) px; covariance : (2, 2) px^2; blur : px; noise, contrast : grey levels."""

    uv: np.ndarray
    covariance: np.ndarray
    blur: float
    noise: float
    contrast: float


def share(h, k, rho):
    """White share of a crossing, white where h and k have the same sign, and its slopes by h, k and rho.

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
    return H * K + (1 - H) * (1 - K) + 2 * both, dh, dk, 2 * density


def fit(image, guess, axes, white, straight, reach):
    """Junction, or the reason (text) why there is none.

    image : (height, width) float; guess : (2,) px; axes : (2, 2) px per square, columns the board's x and y in the image
    white : whether the quadrant between both axes is white; straight : function of pixels (n, 2) to coordinates (n, 2) px in
    which the lens is taken out, and of these back to pixels with a Jacobian; reach : of a square, what is clear beside an edge
    """
    to_straight, to_pixels = straight
    corners = guess + ALONG * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ axes.T
    low, high = np.floor(corners.min(axis=0) - 2).astype(int), np.ceil(corners.max(axis=0) + 2).astype(int)
    if (low < 0).any() or high[0] >= image.shape[1] or high[1] >= image.shape[0]:
        return "too near the image's edge"
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1).astype(float)
    board = (pixels - guess) @ np.linalg.inv(axes).T
    grey, points = image[y, x].ravel(), to_straight(pixels)
    origin, ends = to_straight(guess[None])[0], to_straight(guess + 0.2 * axes.T)
    angles = np.arctan2(*(ends - origin).T[::-1])
    sizes, sine = np.linalg.norm(axes, axis=0), abs(np.sin(angles[1] - angles[0]))
    if sine < 0.2:
        return "seen too obliquely"
    # board x's line is the edge at which y changes sign: its normal is that of the x direction
    p = np.array([*origin, *angles, FIRST_BLUR])
    clear = reach * sizes[::-1] * sine  # px beside the x line and the y line
    light, scatter = None, np.inf
    for iteration in range(ITERATIONS):
        d = points - p[:2]
        c, s = np.cos(p[2:4]), np.sin(p[2:4])
        across = d[:, 1:] * c - d[:, :1] * s  # (n, 2) px from the x line and from the y line
        along = d[:, :1] * c + d[:, 1:] * s
        strip = np.minimum(STRIP * p[4], clear - 2.5 * p[4])
        if (strip < 1.5 * p[4]).any():
            return "too small"
        use = (np.abs(across) < strip).any(axis=1) & (np.abs(board) < ALONG).all(axis=1)
        if use.sum() < LEAST_PIXELS:
            return "too few pixels"
        # the y line's sign is turned so that both are positive in the quadrant between the axes
        turn = np.array([1.0, -1.0]) * np.sign(np.sin(p[3] - p[2]))
        h, k = (turn * across[use] / p[4]).T
        rho = turn[0] * turn[1] * np.cos(p[3] - p[2])
        w, dh, dk, dr = share(h, k, rho)
        if not white:
            w, dh, dk, dr = 1 - w, -dh, -dk, -dr
        near = d[use] / sizes.mean()
        planes = np.stack([w, w * near[:, 0], w * near[:, 1], 1 - w, (1 - w) * near[:, 0], (1 - w) * near[:, 1]], axis=1)
        if light is None:
            light = np.linalg.lstsq(planes, grey[use], rcond=None)[0]
        r = grey[use] - planes @ light
        amplitude = light[0] - light[3] + near @ (light[1:3] - light[4:6])
        if light[0] - light[3] < 1:
            return "white is no brighter than black"
        n1, n2 = turn[0] * np.array([-s[0], c[0]]) / p[4], turn[1] * np.array([-s[1], c[1]]) / p[4]
        J = np.empty((len(r), 11))
        J[:, :2] = -(dh[:, None] * n1 + dk[:, None] * n2)
        J[:, 2] = -dh * turn[0] * along[use, 0] / p[4] + dr * turn[0] * turn[1] * np.sin(p[3] - p[2])
        J[:, 3] = -dk * turn[1] * along[use, 1] / p[4] - dr * turn[0] * turn[1] * np.sin(p[3] - p[2])
        J[:, 4] = -(dh * h + dk * k) / p[4]
        J[:, :5] *= amplitude[:, None]
        J[:, 5:] = planes
        if iteration < SETTLING:  # afterwards it stands, so that the weights can settle too
            scatter = max(1.4826 * np.median(np.abs(r)), 0.3)
        weight = np.minimum(1, (TRUSTED * scatter / np.maximum(np.abs(r), 1e-9)) ** 2)
        A = J * weight[:, None]
        try:
            step = np.linalg.solve(A.T @ J, A.T @ r)
        except np.linalg.LinAlgError:
            return "not determined"
        limit = min(1.0, 2.0 / max(np.abs(step[:2]).max(), 1e-9), 0.1 / max(np.abs(step[2:4]).max(), 1e-9), 0.4 / max(abs(step[4]), 1e-9))
        p += limit * step[:5]
        p[4] = np.clip(p[4], LEAST_BLUR, MOST_BLUR)
        light = light + step[5:]
        moved = np.abs(step[:2]).max()
        if moved < SETTLED and iteration > 3:
            break
    else:
        return "the fit did not settle"
    contrast, noise = light[0] - light[3], np.sqrt((weight * r**2).sum() / max(weight.sum() - 11, 1))
    if contrast < LEAST_CONTRAST * scatter:
        return f"contrast {contrast:.0f} is lost in noise {scatter:.1f}"
    if noise > MISFIT * contrast or (weight < 1).mean() > DOUBTED:
        return f"covered or no corner of this board: the fit leaves {noise / contrast:.0%} of the contrast"
    uv, back = to_pixels(p[:2])
    if np.linalg.norm(np.linalg.solve(axes, uv - guess)) > max(WANDER, 1.5 / sizes.min()):
        return "the fit left the place where it was expected"
    covariance = np.linalg.inv(A.T @ J)[:2, :2] * noise**2
    return Junction(uv, back @ covariance @ back.T, float(p[4]), float(noise), float(contrast))
