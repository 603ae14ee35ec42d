"""Readers of camera calibrations of Kalibr, multical, Caliscope, ROS and OpenCV.

Kalibr, multical, Caliscope, Anipose, ROS and OpenCV, recognised and read.

Source: Kalibr, wiki, "yaml formats" and "supported models"; its pixels are OpenCV's, the first one's centre is 0, 0.

Source: multical, io/export_calib.py and motion/static_frames.py

Source: caliscope, cameras/camera_array.py: a rotation is Rodrigues' vector, of older versions a matrix; lengths are in
    metres

Source: ROS, camera_calibration_parsers and sensor_msgs/CameraInfo; OpenCV,
    samples/cpp/tutorial_code/calib3d/camera_calibration
"""

import re
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera_checks_and_fisheye_conversion import (
    ForeignCamera,
    checked_camera_transform,
    checked_image_size,
    rational_lens_of_fisheye,
    require_opencv_distortion_terms,
    require_valid_skewless_camera_matrix,
)
from rig.formats.importers.camera_calibrations.realsense_intrinsics import is_realsense, read_realsense
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import LARGEST_IMAGE

KALIBR_NAME = re.compile(r"cam(\d{1,4})")
OTHERS = {"omni": "the omnidirectional", "ds": "the double sphere", "eucm": "the extended unified"}


def is_kalibr(root: Entries) -> bool:
    """Whether a file's root table is a Kalibr camchain."""
    return any(
        KALIBR_NAME.fullmatch(key) and isinstance(value, dict) and "intrinsics" in value
        for key, value in root.tree.items()
    )


def read_kalibr(root: Entries) -> list[ForeignCamera]:
    """Read the cameras of a Kalibr camchain, in its order.
    Raises FileError for a lens that is not supported, by its name.
    """
    names = sorted((key for key in root.tree if KALIBR_NAME.fullmatch(key)), key=lambda key: int(key[3:]))
    found, T = [], RigidTransform.identity()
    for number, name in enumerate(names):
        if name != f"cam{number}":
            root.fail(f"{name} stands where cam{number} should: a camera of the chain is missing", name)
        e = root.table(name)
        if number:
            T = T * _step(e)
        found.append(_kalibr_camera(e, name, T))
    return found


def _step(e: Entries) -> RigidTransform:
    """T of the camera before to this one's, out of T_cn_cnm1, which goes the other way."""
    key = "T_cn_cnm1"
    if key not in e.tree:
        e.fail(f"{e.name(key)} is missing: nothing states where {e.path[-1]} is relative to the camera before")
    M = e.array(key, (4, 4))
    if np.abs(M[3] - [0, 0, 0, 1]).max() > 1e-9:
        e.fail(f"{e.name(key)}: its last row must be 0, 0, 0, 1, not {M[3].tolist()}", key, 3)
    return checked_camera_transform(e, key, M[:3, :3], M[:3, 3]).inv()


def _kalibr_camera(e: Entries, name: str, T: RigidTransform) -> ForeignCamera:
    model = e.text("camera_model", default="pinhole")
    if model != "pinhole":
        kind = f"{OTHERS[model]} model" if model in OTHERS else "a model"
        e.fail(
            f"{e.name('camera_model')} = {model!r}: {kind} of Kalibr is not supported, as lenses here are "
            "OpenCV's; calibrate as pinhole-radtan",
            "camera_model",
            value=model,
        )
    fx, fy, cx, cy = e.array("intrinsics", (4,))
    for i, focal in enumerate((fx, fy)):
        if focal <= 0:
            e.fail(
                f"{e.name('intrinsics')}[{i + 1}]: the focal length must be positive px, not {focal:g}",
                "intrinsics",
                i,
                value=focal,
            )
    matrix, wide = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), checked_image_size(e, "resolution")
    kind = e.text("distortion_model", default="none")
    if kind == "none":
        return ForeignCamera(name, wide, matrix, np.zeros(4), T, e)
    if kind == "radtan":
        return ForeignCamera(name, wide, matrix, e.array("distortion_coeffs", (4,)), T, e)
    if kind == "equidistant":
        terms = e.array("distortion_coeffs", (4,))
        keys, lens = (
            ("distortion_model", "distortion_coeffs"),
            f"{name}: its equidistant lens becomes OpenCV's rational one",
        )
        distortion, message = rational_lens_of_fisheye(e, keys, terms, matrix, wide, lens)
        return ForeignCamera(name, wide, matrix, distortion, T, e, message)
    e.fail(
        f"{e.name('distortion_model')} = {kind!r} is not supported; radtan, equidistant and none are",
        "distortion_model",
        value=kind,
    )


MULTICAL_MODELS = ("standard", "rational", "thin_prism", "tilted")  # which are OpenCV's


def is_multical(root: Entries) -> bool:
    """Whether a file's root table is a multical calibration."""
    cameras = root.tree.get("cameras")
    return isinstance(cameras, dict) and any(
        isinstance(camera, dict) and "K" in camera and "dist" in camera for camera in cameras.values()
    )


def read_multical(root: Entries) -> list[ForeignCamera]:
    """Read the cameras of a multical calibration.
    Raises FileError for a lens that is not supported, and for poses that cannot be told apart.
    """
    cameras, poses = root.table("cameras"), root.table("camera_poses", optional=True)
    return [_multical_camera(cameras.table(name), name, poses) for name in cameras.tree]


def _multical_camera(e: Entries, name: str, poses: Entries) -> ForeignCamera:
    model = e.text("model", default="standard")
    if model not in MULTICAL_MODELS:
        e.fail(
            f"{e.name('model')} = {model!r}: no lens of OpenCV's that has a place here; "
            f"{', '.join(MULTICAL_MODELS)} have",
            "model",
            value=model,
        )
    matrix = require_valid_skewless_camera_matrix(e, "K", e.array("K", (3, 3)))
    flat = e.get("dist")
    nested = isinstance(flat, list) and len(flat) == 1 and isinstance(flat[0], list)
    distortion = require_opencv_distortion_terms(e, "dist", e.array("dist", (1, None) if nested else (None,)).ravel())
    keys = [key for key in poses.tree if key == name or key.startswith(f"{name}_to_")]
    if len(keys) > 1:
        poses.fail(f"the pose of {name} is there as {' and as '.join(keys)}", keys[1])
    if not keys:
        return ForeignCamera(name, checked_image_size(e, "image_size"), matrix, distortion, None, e)
    inner = poses.table(keys[0])
    T = checked_camera_transform(inner, "R", inner.array("R", (3, 3)), inner.array("T", (3,))).inv()
    return ForeignCamera(name, checked_image_size(e, "image_size"), matrix, distortion, T, e)


CALISCOPE_NAME = re.compile(r"cam_\d{1,4}")


def is_caliscope_camera_array(root: Entries) -> bool:
    """Whether a file's root table is a Caliscope camera array."""
    return bool(_tables(root))


def read_caliscope(root: Entries) -> list[ForeignCamera]:
    """Read the calibrated cameras of a Caliscope file.

    Raises FileError where there is none.
    """
    found = [
        _caliscope_camera(e, name)
        for name, e in _tables(root).items()
        if not e.flag("ignore", False) and "matrix" in e.tree
    ]
    if not found:
        root.fail("none of its cameras is calibrated")
    return found


def _tables(root: Entries) -> dict[str, Entries]:
    """{name: table of a camera}"""
    cameras = root.tree.get("cameras")
    if isinstance(cameras, dict) and any(
        isinstance(camera, dict) and "distortions" in camera for camera in cameras.values()
    ):
        return {f"cam_{key}": root.table("cameras").table(key) for key in cameras}
    return {
        key: root.table(key)
        for key, value in root.tree.items()
        if CALISCOPE_NAME.fullmatch(key) and isinstance(value, dict) and "distortions" in value
    }


def _caliscope_camera(e: Entries, name: str) -> ForeignCamera:
    matrix, wide, values = (
        require_valid_skewless_camera_matrix(e, "matrix", e.array("matrix", (3, 3))),
        checked_image_size(e, "size"),
        e.array("distortions", (None,)),
    )
    message: tuple[str, ...] = ()
    name = e.text("name", default=name)
    if e.flag("fisheye", False):
        keys, lens = ("fisheye", "distortions"), f"{name}: its fisheye becomes OpenCV's rational lens"
        distortion, message = rational_lens_of_fisheye(e, keys, values, matrix, wide, lens)
    else:
        distortion = require_opencv_distortion_terms(e, "distortions", values)
    if "rotation" not in e.tree or "translation" not in e.tree:
        return ForeignCamera(name, wide, matrix, distortion, None, e, message)
    rows = e.get("rotation")
    whole = isinstance(rows, list) and bool(rows) and isinstance(rows[0], list)
    R = e.array("rotation", (3, 3)) if whole else Rotation.from_rotvec(e.turn("rotation")).as_matrix()
    return ForeignCamera(
        name,
        wide,
        matrix,
        distortion,
        checked_camera_transform(e, "rotation", np.asarray(R), e.array("translation", (3,))).inv(),
        e,
        message,
    )


MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "mtx")
DISTORTION = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "Distortion_Coefficients", "D", "dist")
FISHEYES = ("equidistant", "fisheye")
ROS_MODELS = ("plumb_bob", "rational_polynomial", "thin_prism", *FISHEYES)


def is_opencv_or_ros(root: Entries) -> bool:
    """Whether a file's root table is an OpenCV or ROS camera calibration."""
    return _key(root, MATRIX) is not None and _key(root, DISTORTION) is not None


def read_opencv_or_ros(root: Entries) -> list[ForeignCamera]:
    """Read the one camera of an OpenCV or ROS calibration.
    Raises FileError for a lens that is not supported, by its name.
    """
    name = root.text("camera_name", default=root.file.stem)
    key, bent = _key(root, MATRIX) or MATRIX[0], _key(root, DISTORTION) or DISTORTION[0]
    matrix, values = (
        require_valid_skewless_camera_matrix(root, key, _matrix(root, key, (3, 3))),
        _matrix(root, bent, None).ravel(),
    )
    width, height = (
        root.whole(word, 1, most=LARGEST_IMAGE) if word in root.tree else None
        for word in ("image_width", "image_height")
    )
    size = None if width is None or height is None else (width, height)
    model = root.text("distortion_model", ROS_MODELS, default="plumb_bob")
    if model not in FISHEYES and root.get("fisheye_model", 0) in (0, False):
        return [ForeignCamera(name, size, matrix, require_opencv_distortion_terms(root, bent, values), None, root)]
    if size is None:
        root.fail(
            "image_width and image_height are missing, over which a fisheye is to become a lens of "
            f"{root.file.name}'s camera here"
        )
    keys = ("distortion_model" if model in FISHEYES else "fisheye_model", bent)
    distortion, message = rational_lens_of_fisheye(
        root, keys, values, matrix, size, f"{name}: its fisheye becomes OpenCV's rational lens"
    )
    return [ForeignCamera(name, size, matrix, distortion, None, root, message)]


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


REALSENSE = "rs-enumerate-devices or RealSense's intrinsics"
PROGRAMS: dict[str, tuple[Callable[[Entries], bool], Callable[[Entries], list[ForeignCamera]]]] = {
    "Kalibr": (is_kalibr, read_kalibr),
    "multical": (is_multical, read_multical),
    "caliscope": (is_caliscope_camera_array, read_caliscope),
    "ROS camera_info or OpenCV": (is_opencv_or_ros, read_opencv_or_ros),
    REALSENSE: (is_realsense, read_realsense),
}  # whether a file's root table is of a program, and its cameras
