"""multical camera calibrations (calibration.json).

Source: multical, io/export_calib.py and motion/static_frames.py
"""

from rig.formats.checked_entries import Entries
from rig.formats.importers.camera_calibrations.foreign_camera_and_fisheye_lens import (
    ForeignCamera,
    checked_camera_matrix,
    checked_camera_transform,
    checked_distortion,
    checked_image_size,
)

MODELS = ("standard", "rational", "thin_prism", "tilted")  # which are OpenCV's


def recognises(root: Entries) -> bool:
    """Whether a file's root table is a multical calibration."""
    cameras = root.tree.get("cameras")
    return isinstance(cameras, dict) and any(
        isinstance(camera, dict) and "K" in camera and "dist" in camera for camera in cameras.values()
    )


def read(root: Entries) -> list[ForeignCamera]:
    """Read the cameras of a multical calibration. Raises FileError for an unsupported lens or ambiguous poses.
    Raises FileError for a lens that has no place here, and for poses that cannot be told apart.
    """
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
    matrix = checked_camera_matrix(e, "K", e.array("K", (3, 3)))
    flat = e.get("dist")
    nested = isinstance(flat, list) and len(flat) == 1 and isinstance(flat[0], list)
    distortion = checked_distortion(e, "dist", e.array("dist", (1, None) if nested else (None,)).ravel())
    keys = [key for key in poses.tree if key == name or key.startswith(f"{name}_to_")]
    if len(keys) > 1:
        poses.fail(f"the pose of {name} is there as {' and as '.join(keys)}", keys[1])
    if not keys:
        return ForeignCamera(name, checked_image_size(e, "image_size"), matrix, distortion, None, e)
    inner = poses.table(keys[0])
    T = checked_camera_transform(inner, "R", inner.array("R", (3, 3)), inner.array("T", (3,))).inv()
    return ForeignCamera(name, checked_image_size(e, "image_size"), matrix, distortion, T, e)
