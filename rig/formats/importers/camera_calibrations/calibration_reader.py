"""A file of cameras -> ForeignCameras, by whichever program it is of."""

import tomllib
from pathlib import Path

from rig.errors import FileError
from rig.formats import json_file, yaml_file
from rig.formats.checked_entries import Entries
from rig.formats.importers.camera_calibrations import caliscope, kalibr, multical, opencv_and_ros
from rig.formats.importers.camera_calibrations.foreign_camera import ForeignCamera
from rig.formats.input_files import read_text
from rig.formats.toml_positions import value_positions

KINDS = {"Kalibr": kalibr, "multical": multical, "caliscope": caliscope, "ROS camera_info or OpenCV": opencv_and_ros}
LARGEST = 1 << 22  # bytes


def read_cameras(path: Path) -> tuple[str, list[ForeignCamera]]:
    """(whose file it is, its cameras). Raises FileError, with line and key, for anything that cannot be used."""
    root = _root(path)
    for kind, module in KINDS.items():
        if module.recognises(root):
            return kind, module.read(root)
    target = (
        f"; it holds a target of Kalibr ({root.tree['target_type']}), the cameras are in its camchain"
        if "target_type" in root.tree
        else ""
    )
    raise FileError(
        path,
        f"holds no cameras as {', '.join(KINDS)} write "
        f"them{target or '; its keys are ' + ', '.join(list(root.tree)[:8])}",
    )


def _root(path: Path) -> Entries:
    suffix = path.suffix.lower()
    if suffix == ".json":
        return json_file.load(path, "calibration of cameras")
    if suffix != ".toml":
        if suffix == ".xml":
            raise FileError(
                path, "XML of OpenCV is not read here; write it as .yml (cv2.FileStorage takes the name's end)"
            )
        return yaml_file.load(path)
    text = read_text(path, LARGEST)
    try:
        return Entries(tomllib.loads(text), (), path, value_positions(text))
    except (ValueError, RecursionError) as error:
        raise FileError(path, f"not valid TOML: {str(error) or 'nested too deep'}") from None
