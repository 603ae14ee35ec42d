"""Checks of a foreign camera, and fisheye conversion.

ForeignCamera checks its values; a fisheye lens is converted to a rational one.

Distorted radius theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), theta the angle off the axis.
Source: Kannala and Brandt, 2006; OpenCV, fisheye camera model
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import LARGEST_IMAGE
from rig.model.design import DISTORTION_TERMS

ORTHOGONAL = 1e-3  # that a rotation's product with its transpose may differ from one: files have six digits at times


@dataclass(frozen=True, slots=True, eq=False)
class ForeignCamera:
    """name : theirs; size : width and height, px, or None; matrix : (3, 3) px; distortion : OpenCV's order, of a length
    that a rig.toml takes
    T : T_reference_camera, the reference being their own, or None where nothing tells; remarks : what became of its
    lens;
        at : where it stands"""

    name: str
    size: tuple[int, int] | None
    matrix: Floats
    distortion: Floats
    T: RigidTransform | None
    at: Entries
    remarks: tuple[str, ...] = ()


def checked_image_size(entries: Entries, key: str) -> tuple[int, int]:
    """Image size (width, height) px, checked.

    Raises FileError for anything else.
    """
    found = entries.wholes(key, 1)
    if len(found) != 2 or max(found) > LARGEST_IMAGE:
        entries.fail(f"{entries.name(key)} must be width and height in px, not {short_repr(entries.get(key))}", key)
    return found[0], found[1]


def require_valid_skewless_camera_matrix(entries: Entries, key: str, matrix: Floats) -> Floats:
    """Camera matrix (3, 3) px, checked.

    Raises FileError for a skew, and for what is no camera's matrix.
    """
    off = matrix.copy()
    off[0, 0], off[1, 1], off[:2, 2], off[2, 2] = 0, 0, 0, matrix[2, 2] - 1
    if off[0, 1] and np.count_nonzero(off) == 1:
        entries.fail(
            f"{entries.name(key)} has a skew of {off[0, 1]:g}, which a camera here has not: calibrate with none",
            key,
            value=off[0, 1],
        )
    if off.any() or min(matrix[0, 0], matrix[1, 1]) <= 0:
        entries.fail(
            f"{entries.name(key)} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0, not "
            f"{short_repr(matrix.tolist())}",
            key,
        )
    return matrix


def require_opencv_distortion_terms(entries: Entries, key: str, values: Floats) -> Floats:
    """Distortion terms (n,) of OpenCV, checked.

    None means four zeros.
    Raises FileError for a count that OpenCV lacks.
    """
    if not len(values):
        return np.zeros(4)
    if len(values) not in DISTORTION_TERMS:
        entries.fail(
            f"{entries.name(key)} must have {', '.join(map(str, DISTORTION_TERMS))} terms in OpenCV's order, got "
            f"{len(values)}",
            key,
        )
    return values


def checked_camera_transform(entries: Entries, key: str, R: Floats, t: Floats) -> RigidTransform:
    """Camera transform (RigidTransform) of a rotation matrix R and a position t (3,) m, checked.
    Raises FileError for a matrix that is not a rotation.
    """
    worst = max(float(np.abs(R @ R.T - np.eye(3)).max()), abs(float(np.linalg.det(R)) - 1))
    if worst > ORTHOGONAL:
        entries.fail(
            f"{entries.name(key)} is not a rotation: its product with its transpose is {worst:.2g} away from one", key
        )
    return RigidTransform.from_components(t, Rotation.from_matrix(R))


FOLLOWS = 0.02  # px that the rational lens may be off, anywhere in the image
WIDEST = np.radians(80)  # off the axis; beyond, a plane of ideal image points is no picture any more
POINTS = 400  # along the radius
ROUNDS = 8  # of the fit, weighted by the last one's denominator


def rational_lens_of_fisheye(
    entries: Entries,
    keys: tuple[str, str],
    fisheye_terms: Floats,
    matrix: Floats,
    size: tuple[int, int],
    conversion: str,
) -> tuple[Floats, tuple[str, ...]]:
    """Rational lens of a fisheye.

    keys : of the model and of its terms; matrix : (3, 3) px; size : (width, height) px; conversion : what
        becomes of the lens, in words
    Returns (distortion (8,) in OpenCV's order, sentence on how far it deviates)
    Raises FileError for other than four terms, and where no rational lens follows it, with how far one does
    """
    key, terms_key = keys
    if len(fisheye_terms) != 4:
        entries.fail(f"{entries.name(terms_key)}: a fisheye has 4 terms, got {len(fisheye_terms)}", terms_key)
    corners = np.array([[u, v] for u in (0, size[0] - 1) for v in (0, size[1] - 1)], float)
    focal = np.array([matrix[0, 0], matrix[1, 1]])
    reach = float(np.linalg.norm((corners - matrix[:2, 2]) / focal, axis=1).max())
    theta = np.linspace(0, WIDEST, 20 * POINTS)
    radius = _fisheye_radius(theta, fisheye_terms)
    grows = np.diff(radius) > 0
    last = int(np.argmin(grows)) if not grows.all() else len(radius) - 1
    if radius[last] < reach:
        entries.fail(
            f"{entries.name(key)}: an equidistant lens that reaches more than {np.degrees(theta[last]):.0f} "
            "degrees off the axis in the image's corners "
            "is not supported: OpenCV's rational lens, which a rig.toml takes, cannot follow it",
            key,
        )
    angle = np.interp(np.linspace(0, reach, POINTS + 1)[1:], radius[: last + 1], theta[: last + 1])
    wanted = _fisheye_radius(angle, fisheye_terms)
    coefficients = _fitted(np.tan(angle), wanted)
    off = float(np.abs(_radius(np.tan(angle), coefficients) - wanted).max() * focal.max())
    if not off <= FOLLOWS:
        entries.fail(
            f"{entries.name(key)}: an equidistant lens, which reaches {np.degrees(angle[-1]):.0f} degrees off the "
            "axis: OpenCV's rational lens, which a "
            f"rig.toml takes, follows it to {off:.2g} px only, more than {FOLLOWS:g} px; `rig lens` fits "
            "another to photographs of a board",
            key,
        )
    a, d = coefficients[:3], coefficients[3:]
    sentence = f"{conversion}, which follows it to {off:.2g} px in the whole image"
    return np.array([a[0], a[1], 0, 0, a[2], *d]), (sentence,)


def _fisheye_radius(theta: Floats, k: Floats) -> Floats:
    return theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)


def _radius(r: Floats, c: Floats) -> Floats:
    s = r**2
    return r * (1 + s * (c[0] + s * (c[1] + s * c[2]))) / (1 + s * (c[3] + s * (c[4] + s * c[5])))


def _fitted(r: Floats, wanted: Floats) -> Floats:
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
