"""Geometry of a mechanism as JSON or CSV in m and rad; a camera's matrix and distortion as ROS or OpenCV YAML.

Source: ROS, camera_calibration_parsers, sensor_msgs/CameraInfo and distortion_models.hpp; OpenCV, FileStorage
"""

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from rig.arrays import Floats
from rig.errors import RigError
from rig.model.design import Camera
from rig.model.mechanism_geometry import Arm, Hexapod
from rig.model.mechanism_kinds import has_plates
from rig.model.pose import pose_to_entry, pose_to_vector

HEXAPOD = (
    "strut",
    "base_x",
    "base_y",
    "base_z",
    "platform_x",
    "platform_y",
    "platform_z",
    "zero",
    "shortest",
    "longest",
)
ARM = ("joint", "theta", "d", "a", "alpha", "beta", "lowest", "highest", "slides")


def geometry_json(mechanism: Hexapod | Arm) -> str:
    """Geometry of a Hexapod or an Arm as JSON."""
    if has_plates(mechanism):
        tree = {
            name: getattr(mechanism, name).tolist()
            for name in ("base_joints", "platform_joints", "strut_zeros", "strut_range")
        }
        tree["home"] = pose_to_entry(mechanism.home)
    else:
        tree = {
            "joints": mechanism.joints.tolist(),
            "limits": mechanism.limits.tolist(),
            "slides": mechanism.slides.tolist(),
        }
        tree |= {
            name: pose_to_vector(getattr(mechanism, name)).tolist()
            for name in ("base", "tool")
            if hasattr(mechanism, name)
        }
    return json.dumps({"schema": "geometry/1", "kind": mechanism.kind, "units": "m, rad", **tree}, indent=1) + "\n"


def geometry_csv(mechanism: Hexapod | Arm) -> str:
    """Geometry as CSV: a row per strut of a Hexapod, a row per joint of an Arm."""
    header: tuple[str, ...]
    parts: Iterable[tuple[Any, ...]]
    if has_plates(mechanism):
        header, last = HEXAPOD, [""] * len(mechanism.axes)
        parts = zip(
            mechanism.base_joints, mechanism.platform_joints, mechanism.strut_zeros[:, None], mechanism.strut_range
        )
    else:
        header, last = ARM, [f",{int(slide)}" for slide in mechanism.slides]
        parts = zip(mechanism.rows, mechanism.limits)
    rows = [
        ",".join([str(i + 1), *(f"{value:.12f}" for part in row for value in part)]) + end
        for i, (row, end) in enumerate(zip(parts, last))
    ]
    return "\n".join([",".join(header), *rows]) + "\n"


ROS = {5: "plumb_bob", 8: "rational_polynomial"}  # models, by their terms


def ros_camera_info(camera: Camera) -> str:
    """ROS camera_info YAML of a Camera. Raises RigError for a lens that ROS has no model of."""
    terms = np.append(camera.distortion, 0.0) if len(camera.distortion) == 4 else camera.distortion
    if len(terms) not in ROS:
        raise RigError(
            f"camera {camera.name} has a lens of {len(terms)} terms; camera_info has models of "
            f"{' and '.join(map(str, ROS))}; OpenCV's "
            "own format takes it (--format opencv)"
        )
    projection = np.hstack([camera.matrix, np.zeros((3, 1))])
    parts = [
        f"image_width: {camera.width}",
        f"image_height: {camera.height}",
        f"camera_name: {camera.name}",
        *_block("camera_matrix", camera.matrix),
        f"distortion_model: {ROS[len(terms)]}",
        *_block("distortion_coefficients", terms[None]),
        *_block("rectification_matrix", np.eye(3)),
        *_block("projection_matrix", projection),
    ]
    return "\n".join(parts) + "\n"


def opencv_camera_yaml(camera: Camera) -> str:
    """OpenCV FileStorage YAML of a Camera."""
    parts = [
        "%YAML:1.0",
        "---",
        f"image_width: {camera.width}",
        f"image_height: {camera.height}",
        f'camera_name: "{camera.name}"',
        *_block("camera_matrix", camera.matrix, " !!opencv-matrix"),
        *_block("distortion_coefficients", camera.distortion[:, None], " !!opencv-matrix"),
    ]
    return "\n".join(parts) + "\n"


def _block(key: str, matrix: Floats, tag: str = "") -> list[str]:
    kind = ["   dt: d"] if tag else []
    return [
        f"{key}:{tag}",
        f"   rows: {matrix.shape[0]}",
        f"   cols: {matrix.shape[1]}",
        *kind,
        f"   data: [{_figures(matrix.ravel())}]",
    ]


def _figures(values: Sequence[float] | Floats) -> str:
    """Numbers to the last bit, each with a point: YAML 1.1 and OpenCV take 1e-05 for a word, and 1 for a whole
    number.
    """
    words = [repr(float(value)) for value in values]
    return ", ".join(word if "." in word or "e" not in word else word.replace("e", ".0e") for word in words)
