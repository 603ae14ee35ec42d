"""Intrinsics of RealSense cameras.

What `rs-enumerate-devices -c` prints, or JSON and YAML of the same figures.
A stream is a camera, by its name and size: color-1280x720. Five coefficients are k1, k2, p1, p2, k3, as OpenCV's.
Brown-Conrady is OpenCV's lens. Its inverse undistorts by the same formula, and modified Brown-Conrady takes its
tangential part at points distorted radially: both become the lens of OpenCV that follows them.
Source: librealsense, doc/projection.md, "distortion models", and rs2_deproject_pixel_to_point
"""

import re
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from rig.array_and_json_types import Floats
from rig.errors import FileError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera_checks_and_fisheye_conversion import ForeignCamera
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import LARGEST_IMAGE

HEAD = re.compile(r'\s*Intrinsic of "([^"]+)"')
LINE = re.compile(r"\s*(Width|Height|PPX|PPY|Fx|Fy|Distortion|Coeffs)\s*:\s*(.*?)\s*$")
FIGURES = ("ppx", "ppy", "fx", "fy")
MODELS = {"none": "none", "brownconrady": "plain", "inversebrownconrady": "inverse", "modifiedbrownconrady": "modified"}
FOLLOWS = 0.05  # px that OpenCV's lens may be off, anywhere in the image; a factory's calibration is less sure
EDGE = 41  # points along each side of an image over which a lens is fitted
STEPS = 30
SIZE = 0.1  # of a lens' terms


def realsense_text_entries(text: str, file: Path) -> Entries | None:
    """Entries of the text of `rs-enumerate-devices -c`.

    {stream: its figures}; None of any other text.
    Raises FileError, with its line, for a figure that is none, and for a stream that is listed twice and differs
    """
    tree: dict[str, dict[str, object]] = {}
    places: dict[tuple[str, ...], tuple[int, int]] = {(): (1, 1)}
    blocks: list[tuple[str, int, dict[str, object], dict[str, int]]] = []
    for number, line in enumerate(text.splitlines(), 1):
        head, found = HEAD.match(line), LINE.match(line)
        if head:
            blocks.append((head[1], number, {}, {}))
        elif found and blocks and found[1].lower() not in blocks[-1][2]:
            key = found[1].lower()
            blocks[-1][2][key], blocks[-1][3][key] = _value(key, found[2], file, number), number
    if not blocks:
        return None
    for stream, at, figures, lines in blocks:
        size = "x".join(str(figures.get(key, "?")) for key in ("width", "height"))
        name = f"{stream.lower().replace(' ', '-')}-{size}"
        if tree.get(name, figures) != figures:
            raise FileError(file, f"{name} is listed twice with different figures", at)
        tree[name] = figures
        places[name,] = (at, 1)
        places |= {(name, key): (number, 1) for key, number in lines.items()}
    return Entries(tree, (), file, places)


def _value(key: str, text: str, file: Path, line: int) -> object:
    """A figure, the coefficients or the distortion's name, of a line of the text."""
    if key == "distortion":
        return text
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if key == "coeffs":
        return numbers
    if len(numbers) != 1:
        raise FileError(file, f"{key} must be a number, not {text!r}", line)
    return int(numbers[0]) if key in ("width", "height") else numbers[0]


def is_realsense(root: Entries) -> bool:
    """Whether a file's root table holds intrinsics of a RealSense camera.

    Itself or in tables by stream.
    """
    return bool(_tables(root))


def _tables(root: Entries) -> dict[str, Entries]:
    """{name of a stream: its table}."""
    if all(key in root.tree for key in FIGURES):
        return {root.file.stem: root}
    return {
        key: root.table(key)
        for key, value in root.tree.items()
        if isinstance(value, dict) and all(figure in value for figure in FIGURES)
    }


def read_realsense(root: Entries) -> list[ForeignCamera]:
    """Read the cameras of RealSense intrinsics, one for each stream and size.

    Raises FileError for a lens that is not supported, by its name
    """
    return [_camera(e, name) for name, e in _tables(root).items()]


def _camera(e: Entries, name: str) -> ForeignCamera:
    size = (e.whole("width", 1, most=LARGEST_IMAGE), e.whole("height", 1, most=LARGEST_IMAGE))
    ppx, ppy, fx, fy = (e.number(key) for key in FIGURES)
    for key, focal in (("fx", fx), ("fy", fy)):
        if focal <= 0:
            e.fail(f"{e.name(key)} must be above 0 px, not {focal:g}", key, value=focal)
    key = next((key for key in ("distortion", "model", "distortion_model") if key in e.tree), "distortion")
    stated = e.text(key)
    model = MODELS.get(re.sub(r"[^a-z]", "", stated.lower().removeprefix("distortion.")))
    matrix, terms = np.array([[fx, 0, ppx], [0, fy, ppy], [0, 0, 1]]), e.array("coeffs", (5,))
    if not terms.any() and model is not None:
        return ForeignCamera(name, size, matrix, np.zeros(5), None, e)
    if model == "plain":
        return ForeignCamera(name, size, matrix, terms, None, e)
    if model not in ("inverse", "modified"):
        e.fail(
            f"{e.name(key)} = {stated!r} is not supported; Brown Conrady, its inverse and modified form, and None are",
            key,
            value=stated,
        )
    lens, off = _opencv_lens(terms, model, matrix, size)
    if off > FOLLOWS:
        e.fail(
            f"{e.name(key)} = {stated!r}: OpenCV's lens follows it to {off:.2g} px only, more than {FOLLOWS:g} px; "
            "`rig lens` fits another to photographs of a board",
            key,
            value=stated,
        )
    remark = f"{name}: its lens, {stated}, becomes OpenCV's, which follows it to {off:.2g} px in the whole image"
    return ForeignCamera(name, size, matrix, lens, None, e, (remark,))


def _opencv_lens(terms: Floats, model: str, matrix: Floats, size: tuple[int, int]) -> tuple[Floats, float]:
    """(distortion (12,) in OpenCV's order, px by which it is off at the most) of an inverse or modified lens.

    terms : (5,) k1, k2, p1, p2, k3; least squares over the image
    """
    u, v = np.meshgrid(*(np.linspace(0, length - 1, EDGE) for length in size))
    focal = np.array([matrix[0, 0], matrix[1, 1]])
    seen = (np.stack([u.ravel(), v.ravel()], axis=1) - matrix[:2, 2]) / focal
    ideal = _opencv_distorted(terms, seen) if model == "inverse" else _undone(terms, seen)

    def off(lens: Floats) -> Floats:
        return np.asarray((_opencv_distorted(lens, ideal) - seen) * focal)

    start = np.concatenate([-terms if model == "inverse" else terms, np.zeros(7)])
    found = least_squares(lambda lens: off(lens).ravel(), start, x_scale=SIZE, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return found.x, float(np.abs(off(found.x)).max())


def _opencv_distorted(lens: Floats, points: Floats) -> Floats:
    """Points (n, 2) distorted by OpenCV's lens, (12,) or its first (5,) terms: rational, tangential and thin prism."""
    x, y = points.T
    s = x**2 + y**2
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = np.pad(lens, (0, 12 - len(lens)))
    f = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    return np.stack(
        [
            x * f + 2 * p1 * x * y + p2 * (s + 2 * x**2) + s1 * s + s2 * s**2,
            y * f + 2 * p2 * x * y + p1 * (s + 2 * y**2) + s3 * s + s4 * s**2,
        ],
        axis=1,
    )


def _undone(terms: Floats, seen: Floats) -> Floats:
    """Points (n, 2) that modified Brown-Conrady takes to those seen: the tangential part at radially distorted ones."""
    k1, k2, _, _, k3 = terms
    turned, radial = terms * [0, 0, 1, 1, 0], np.array([k1, k2, 0.0, 0.0, k3])
    out = seen.copy()
    for _ in range(STEPS):
        out = out + seen - _opencv_distorted(turned, _opencv_distorted(radial, out))
    return out
