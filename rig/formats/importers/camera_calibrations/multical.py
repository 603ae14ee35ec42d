"""multical's calibration.json: cameras, and camera_poses that take points of the rig's frame, or of a master camera's,
to a camera's.

Source: multical, io/export_calib.py and motion/static_frames.py
"""

from rig.formats.checked_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera import (
    ForeignCamera,
    camera_matrix,
    camera_transform,
    distortion_terms,
    image_size,
)

MODELS = ("standard", "rational", "thin_prism", "tilted")  # which are OpenCV's


def recognises(root: Entries) -> bool:
    """Whether this is a result of multical."""
    cameras = root.tree.get("cameras")
    return isinstance(cameras, dict) and any(
        isinstance(camera, dict) and "K" in camera and "dist" in camera for camera in cameras.values()
    )


def read(root: Entries) -> list[ForeignCamera]:
    """The cameras. Raises FileError for a lens that has no place here, and for poses that cannot be told apart."""
    cameras, poses = root.table("cameras"), root.table("camera_poses", optional=True)
    return [_camera(cameras.table(name), name, poses) for name in cameras.tree]


def _camera(e: Entries, name: str, poses: Entries) -> ForeignCamera:
    model = e.text("model", default="standard")
    if model not in MODELS:
        e.fail(
            f"{e.name('model')} = {model!r}: no lens of OpenCV's that has a place here; {', '.join(MODELS)} have",
            "model",
            value=model,
        )
    matrix = camera_matrix(e, "K", e.array("K", (3, 3)))
    flat = e.get("dist")
    nested = isinstance(flat, list) and len(flat) == 1 and isinstance(flat[0], list)
    distortion = distortion_terms(e, "dist", e.array("dist", (1, None) if nested else (None,)).ravel())
    keys = [key for key in poses.tree if key == name or key.startswith(f"{name}_to_")]
    if len(keys) > 1:
        poses.fail(f"the pose of {name} is there as {' and as '.join(keys)}", keys[1])
    if not keys:
        return ForeignCamera(name, image_size(e, "image_size"), matrix, distortion, None, e)
    inner = poses.table(keys[0])
    T = camera_transform(inner, "R", inner.array("R", (3, 3)), inner.array("T", (3,))).inv()
    return ForeignCamera(name, image_size(e, "image_size"), matrix, distortion, T, e)
