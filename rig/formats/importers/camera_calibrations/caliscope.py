"""Caliscope and Anipose camera calibrations (camera_array.toml).

Source: caliscope, cameras/camera_array.py: a rotation is Rodrigues' vector, of older versions a matrix; lengths are in
    metres
"""

import re

import numpy as np
from scipy.spatial.transform import Rotation

from rig.formats.checked_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera_and_fisheye_lens import (
    ForeignCamera,
    checked_camera_matrix,
    checked_camera_transform,
    checked_distortion,
    checked_image_size,
    conversion_sentence,
    rational_lens_of_fisheye,
    require_four_fisheye_terms,
)

NAME = re.compile(r"cam_\d{1,4}")


def recognises(root: Entries) -> bool:
    """Whether a file's root table is a Caliscope camera array."""
    return bool(_tables(root))


def read(root: Entries) -> list[ForeignCamera]:
    """Read the calibrated cameras of a Caliscope file. Raises FileError where there is none."""
    found = [
        _camera(e, name) for name, e in _tables(root).items() if not e.flag("ignore", False) and "matrix" in e.tree
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
        if NAME.fullmatch(key) and isinstance(value, dict) and "distortions" in value
    }


def _camera(e: Entries, name: str) -> ForeignCamera:
    matrix, wide, values = (
        checked_camera_matrix(e, "matrix", e.array("matrix", (3, 3))),
        checked_image_size(e, "size"),
        e.array("distortions", (None,)),
    )
    said: tuple[str, ...] = ()
    name = e.text("name", default=name)
    if e.flag("fisheye", False):
        require_four_fisheye_terms(e, "distortions", values)
        distortion, off = rational_lens_of_fisheye(e, "fisheye", values, matrix, wide)
        said = (conversion_sentence(name, off),)
    else:
        distortion = checked_distortion(e, "distortions", values)
    if "rotation" not in e.tree or "translation" not in e.tree:
        return ForeignCamera(name, wide, matrix, distortion, None, e, said)
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
        said,
    )
