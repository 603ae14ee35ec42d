"""OpenCV and ROS camera calibrations: one camera's matrix and distortion as YAML or JSON, no pose.

Source: ROS, camera_calibration_parsers and sensor_msgs/CameraInfo; OpenCV,
    samples/cpp/tutorial_code/calib3d/camera_calibration
"""

from rig.arrays import Floats
from rig.formats.checked_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera_and_fisheye_lens import (
    ForeignCamera,
    checked_camera_matrix,
    checked_distortion,
    conversion_sentence,
    rational_lens_of_fisheye,
    require_four_fisheye_terms,
)
from rig.formats.rig_toml.camera_instrument_and_cube_entries import LARGEST_IMAGE

MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "mtx")
DISTORTION = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "Distortion_Coefficients", "D", "dist")
FISHEYES = ("equidistant", "fisheye")
MODELS = ("plumb_bob", "rational_polynomial", "thin_prism", *FISHEYES)


def recognises(root: Entries) -> bool:
    """Whether a file's root table is an OpenCV or ROS camera calibration."""
    return _key(root, MATRIX) is not None and _key(root, DISTORTION) is not None


def read(root: Entries) -> list[ForeignCamera]:
    """Read the one camera of an OpenCV or ROS calibration. Raises FileError for an unsupported lens.
    Raises FileError for a lens that has no place here, by its name.
    """
    name = root.text("camera_name", default=root.file.stem)
    key, bent = _key(root, MATRIX) or MATRIX[0], _key(root, DISTORTION) or DISTORTION[0]
    matrix, values = checked_camera_matrix(root, key, _matrix(root, key, (3, 3))), _matrix(root, bent, None).ravel()
    width, height = (
        root.whole(word, 1, most=LARGEST_IMAGE) if word in root.tree else None
        for word in ("image_width", "image_height")
    )
    size = None if width is None or height is None else (width, height)
    model = root.text("distortion_model", MODELS, default="plumb_bob")
    if model not in FISHEYES and root.get("fisheye_model", 0) in (0, False):
        return [ForeignCamera(name, size, matrix, checked_distortion(root, bent, values), None, root)]
    require_four_fisheye_terms(root, bent, values)
    if size is None:
        root.fail(
            "image_width and image_height are missing, over which a fisheye is to become a lens of "
            f"{root.file.name}'s camera here"
        )
    distortion, off = rational_lens_of_fisheye(
        root, "distortion_model" if model in FISHEYES else "fisheye_model", values, matrix, size
    )
    return [ForeignCamera(name, size, matrix, distortion, None, root, (conversion_sentence(name, off),))]


def _key(root: Entries, names: tuple[str, ...]) -> str | None:
    return next((name for name in names if isinstance(root.tree.get(name), dict | list)), None)


def _matrix(root: Entries, key: str, shape: tuple[int, int] | None) -> Floats:
    """A matrix of rows, cols and data, or of nested lists. shape : that it must have, None for one row or one column"""
    if isinstance(root.tree[key], list):
        nested = bool(root.tree[key]) and isinstance(root.tree[key][0], list)
        return root.array(key, shape or ((None, None) if nested else (None,)))
    e = root.table(key)
    if "sizes" in e.tree and shape is None:  # one dimension, as OpenCV 5 has it
        return e.array("data", e.wholes("sizes")[:1])
    rows, columns = e.whole("rows", 0), e.whole("cols", 0)
    if shape not in (None, (rows, columns)) or (shape is None and min(rows, columns) > 1):
        wanted = "one row or one column" if shape is None else "x".join(map(str, shape))
        e.fail(f"{e.name('rows')} and cols must be {wanted}, not {rows}x{columns}", "rows")
    return e.array("data", (rows * columns,)).reshape(rows, columns)
