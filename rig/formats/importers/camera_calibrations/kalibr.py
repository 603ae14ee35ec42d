"""Kalibr camera calibrations (camchain.yaml).

Source: Kalibr, wiki, "yaml formats" and "supported models"; its pixels are OpenCV's, the first one's centre is 0, 0.
"""

import re

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.formats.checked_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera_and_fisheye_lens import (
    ForeignCamera,
    checked_camera_transform,
    checked_image_size,
    rational_lens_of_fisheye,
)

NAME = re.compile(r"cam(\d{1,4})")
OTHERS = {"omni": "the omnidirectional", "ds": "the double sphere", "eucm": "the extended unified"}


def recognises(root: Entries) -> bool:
    """Whether a file's root table is a Kalibr camchain."""
    return any(
        NAME.fullmatch(key) and isinstance(value, dict) and "intrinsics" in value for key, value in root.tree.items()
    )


def read(root: Entries) -> list[ForeignCamera]:
    """Read the cameras of a Kalibr camchain, in its order. Raises FileError for an unsupported lens.
    Raises FileError for a lens that has no place here, by its name.
    """
    names = sorted((key for key in root.tree if NAME.fullmatch(key)), key=lambda key: int(key[3:]))
    found, T = [], RigidTransform.identity()
    for number, name in enumerate(names):
        if name != f"cam{number}":
            root.fail(f"{name} stands where cam{number} should: a camera of the chain is missing", name)
        e = root.table(name)
        if number:
            T = T * _step(e)
        found.append(_camera(e, name, T))
    return found


def _step(e: Entries) -> RigidTransform:
    """T of the camera before to this one's, out of T_cn_cnm1, which goes the other way."""
    key = "T_cn_cnm1"
    if key not in e.tree:
        e.fail(f"{e.name(key)} is missing: nothing tells where {e.path[-1]} stands to the camera before")
    M = e.array(key, (4, 4))
    if np.abs(M[3] - [0, 0, 0, 1]).max() > 1e-9:
        e.fail(f"{e.name(key)}: its last row must be 0, 0, 0, 1, not {M[3].tolist()}", key, 3)
    return checked_camera_transform(e, key, M[:3, :3], M[:3, 3]).inv()


def _camera(e: Entries, name: str, T: RigidTransform) -> ForeignCamera:
    model = e.text("camera_model", default="pinhole")
    if model != "pinhole":
        kind = f"{OTHERS[model]} model" if model in OTHERS else "a model"
        e.fail(
            f"{e.name('camera_model')} = {model!r}: {kind} of Kalibr has no place here, where lenses are "
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
        distortion, off = rational_lens_of_fisheye(
            e, "distortion_model", e.array("distortion_coeffs", (4,)), matrix, wide
        )
        return ForeignCamera(
            name,
            wide,
            matrix,
            distortion,
            T,
            e,
            (
                f"{name}: its equidistant lens becomes OpenCV's rational one, which follows it to {off:.2g} "
                "px in the whole image",
            ),
        )
    e.fail(
        f"{e.name('distortion_model')} = {kind!r} has no place here; radtan, equidistant and none have",
        "distortion_model",
        value=kind,
    )
