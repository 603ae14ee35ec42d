"""Camera calibration as ROS camera_info YAML or OpenCV FileStorage YAML: matrix and distortion, no pose.

Source: ROS, camera_calibration_parsers, sensor_msgs/CameraInfo and distortion_models.hpp; OpenCV, FileStorage
"""

from collections.abc import Sequence

import numpy as np

from rig.arrays import Floats
from rig.errors import RigError
from rig.model.design import Camera

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
