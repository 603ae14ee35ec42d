"""An equidistant fisheye as OpenCV's rational lens, where that follows it over the whole image; where it does not, it
is refused by name.

Distorted radius theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), theta the angle off the axis.
Source: Kannala and Brandt, 2006; OpenCV, fisheye camera model
"""

import numpy as np

from rig.formats.checked_entries import Entries

FOLLOWS = 0.02  # px that the rational lens may be off, anywhere in the image
WIDEST = np.radians(80)  # off the axis; beyond, a plane of ideal image points is no picture any more
POINTS = 400  # along the radius
ROUNDS = 8  # of the fit, weighted by the last one's denominator


def rational_lens_of_fisheye(
    e: Entries, key: str, k: np.ndarray, matrix: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, float]:
    """(distortion (8,) in OpenCV's order, the most it is off in px) of equidistant coefficients k (4,).

    matrix : (3, 3) px; size : (width, height) px. Raises FileError where no rational lens follows it, with how far one
        does
    """
    corners = np.array([[u, v] for u in (0, size[0] - 1) for v in (0, size[1] - 1)], float)
    focal = np.array([matrix[0, 0], matrix[1, 1]])
    reach = float(np.linalg.norm((corners - matrix[:2, 2]) / focal, axis=1).max())
    theta = np.linspace(0, WIDEST, 20 * POINTS)
    radius = theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)
    grows = np.diff(radius) > 0
    last = int(np.argmin(grows)) if not grows.all() else len(radius) - 1
    if radius[last] < reach:
        e.fail(
            f"{e.name(key)}: an equidistant lens that reaches more than {np.degrees(theta[last]):.0f} "
            "degrees off the axis in the image's corners "
            "has no place here: OpenCV's rational lens, which a rig.toml takes, cannot follow it",
            key,
        )
    angle = np.interp(np.linspace(0, reach, POINTS + 1)[1:], radius[: last + 1], theta[: last + 1])
    wanted = angle * (1 + k[0] * angle**2 + k[1] * angle**4 + k[2] * angle**6 + k[3] * angle**8)
    coefficients = _fitted(np.tan(angle), wanted)
    off = float(np.abs(_radius(np.tan(angle), coefficients) - wanted).max() * focal.max())
    if not off <= FOLLOWS:
        e.fail(
            f"{e.name(key)}: an equidistant lens, which reaches {np.degrees(angle[-1]):.0f} degrees off the "
            "axis: OpenCV's rational lens, which a "
            f"rig.toml takes, follows it to {off:.2g} px only, more than {FOLLOWS:g} px; `rig lens` fits "
            "another to photographs of a board",
            key,
        )
    a, d = coefficients[:3], coefficients[3:]
    return np.array([a[0], a[1], 0, 0, a[2], *d]), off


def require_four_terms(e: Entries, key: str, values: np.ndarray) -> None:
    """Raise FileError for terms (n,) that are not the four of a fisheye."""
    if len(values) != 4:
        e.fail(f"{e.name(key)}: a fisheye has 4 terms, got {len(values)}", key)


def conversion_sentence(name: str, off: float) -> str:
    """What is said of a camera whose fisheye became a rational lens. off : px"""
    return f"{name}: its fisheye becomes OpenCV's rational lens, which follows it to {off:.2g} px in the whole image"


def _radius(r: np.ndarray, c: np.ndarray) -> np.ndarray:
    s = r**2
    return r * (1 + s * (c[0] + s * (c[1] + s * c[2]))) / (1 + s * (c[3] + s * (c[4] + s * c[5])))


def _fitted(r: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(6,) of a numerator and a denominator, linear least squares in turn: each round's error is divided by the last
    one's denominator.
    """
    scale = r[-1] ** 2
    s = r**2 / scale
    columns = np.stack([s, s**2, s**3, *(-(wanted / r) * s**n for n in (1, 2, 3))], axis=1)
    weight = r
    for _ in range(ROUNDS):
        found = np.linalg.lstsq(columns * weight[:, None], (wanted / r - 1) * weight, rcond=None)[0]
        weight = r / np.abs(1 + s * (found[3] + s * (found[4] + s * found[5])))
    return found / np.tile(scale ** np.arange(1, 4), 2)
