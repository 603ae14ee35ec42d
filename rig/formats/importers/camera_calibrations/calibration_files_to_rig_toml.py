"""Camera calibration files written into a rig.toml.

Files of other programs are read, and their cameras written.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries, rig_part_name_problem
from rig.formats.importers.camera_calibrations.foreign_camera_checks_and_fisheye_conversion import ForeignCamera
from rig.formats.importers.camera_calibrations.kalibr_multical_caliscope_ros_opencv_camera_readers import (
    PROGRAMS,
    REALSENSE,
)
from rig.formats.importers.camera_calibrations.realsense_intrinsics import realsense_text_entries
from rig.formats.importers.foreign_file_import_recipe import Cameras
from rig.formats.local_and_remote_input_files import read_text, short_repr
from rig.formats.numbers_and_units import parse_numbers, stated_units
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import (
    camera_toml,
    rig_toml_with_camera_values_replaced,
)
from rig.model.design import Camera
from rig.model.pose import pose

LARGEST = 1 << 22  # bytes


def read_calibration_program_and_cameras(path: Path) -> tuple[str, list[ForeignCamera]]:
    """Read a camera calibration file: the program that wrote it, and its cameras.

    Returns the program that wrote it, and the cameras in it (ForeignCameras).
    Raises FileError, with line and key, for anything that cannot be used.
    """
    root = _root(path)
    for program, (recognises, read) in PROGRAMS.items():
        if recognises(root):
            return program, read(root)
    target = (
        f"; it holds a target of Kalibr ({root.tree['target_type']}), the cameras are in its camchain"
        if "target_type" in root.tree
        else ""
    )
    raise FileError(
        path,
        f"holds no cameras as {', '.join(PROGRAMS)} write "
        f"them{target or '; its keys are ' + ', '.join(list(root.tree)[:8])}",
    )


def _root(path: Path) -> Entries:
    suffix = path.suffix.lower()
    if suffix == ".json":
        return json_toml_and_yaml_loading.load_json(path, "calibration of cameras")
    if suffix not in (".toml", ".yaml", ".yml"):
        found = realsense_text_entries(read_text(path, LARGEST), path)
        if found is not None:
            return found
    if suffix != ".toml":
        if suffix == ".xml":
            raise FileError(
                path, "XML of OpenCV is not read here; write it as .yml (cv2.FileStorage takes the name's end)"
            )
        return json_toml_and_yaml_loading.load_yaml(path)
    return json_toml_and_yaml_loading.toml_entries(read_text(path, LARGEST), path)


def rig_toml_with_cameras(
    settings: Cameras, text: str, present_cameras: Sequence[Camera]
) -> tuple[str, tuple[str, ...]]:
    """The rig.toml text with imported cameras.

    They replace cameras or are added; with sentences on what was found.
    text : a valid rig.toml; present_cameras : its cameras. Raises RigError where names or places are not told, and for
        another size of image
    """
    known = {camera.name: camera for camera in present_cameras}
    lines: tuple[str, ...] = ()
    changed: list[Camera] = []
    for file in settings.files:
        kind, found = read_calibration_program_and_cameras(file)
        if kind == REALSENSE:
            found = _streams_of_rig(found, settings, known, file)
        named = {_ours(one, settings, known, alone=len(found) * len(settings.files) == 1): one for one in found}
        if len(named) < len(found):
            raise RigError(f"{file}: two of its cameras would be one: --set cameras.names.THEIRS=OURS separates them")
        T_base, base_remarks = _anchor(named, known, settings, file)
        changed += [_camera(name, one, known.get(name), T_base) for name, one in named.items()]
        lines += (f"{file.name} is a result of {kind}: {len(found)} camera{'s' * (len(found) > 1)}", *base_remarks)
        lines += tuple(line for one in found for line in one.remarks)
    names = [camera.name for camera in changed]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise RigError(f"camera {twice} occurs twice; --set cameras.names.THEIRS=OURS separates cameras")
    added = [camera for camera in changed if camera.name not in known]
    if len(added) < len(changed):
        text = rig_toml_with_camera_values_replaced(text, [camera for camera in changed if camera.name in known])
    units = stated_units(tomllib.loads(text))
    for camera in added:
        text = text.rstrip("\n") + "\n\n" + camera_toml(camera, has_pose=True, units=units)
    return text, lines + ((f"added to rig.toml: {', '.join(camera.name for camera in added)}",) if added else ())


def _streams_of_rig(
    found: list[ForeignCamera], settings: Cameras, known: dict[str, Camera], file: Path
) -> list[ForeignCamera]:
    """Of a RealSense's streams and sizes those that are named, or else the one of the size of rig.toml's only camera.

    Raises RigError where neither tells which it is
    """
    named = [one for one in found if one.name in dict(settings.names)]
    if named or len(found) == 1:
        return named or found
    sizes = {(camera.width, camera.height) for camera in known.values()}
    fitting = [one for one in found if one.size in sizes and one.name.startswith("color")] if len(known) == 1 else []
    if len(fitting) != 1:
        raise RigError(
            f"{file} lists {', '.join(one.name for one in found)}: --set cameras.names.STREAM=OURS states which "
            "is which camera of rig.toml"
        )
    return fitting


def _ours(one: ForeignCamera, stated: Cameras, known: dict[str, Camera], alone: bool) -> str:
    """Our name of a camera: as stated, the same, or the only one there is."""
    name = dict(stated.names).get(one.name)
    if name is None and (one.name in known or not known):
        name = one.name
    if name is None and alone and len(known) == 1:
        name = next(iter(known))
    if name is None:
        setting = f"--set cameras.names.{one.name}="
        one.at.fail(
            f"camera {short_repr(one.name)} is none of rig.toml's, {', '.join(known)}: "
            f"{setting}{next(iter(known))} says which it is, "
            f"{setting}{one.name} adds it"
        )
    if rig_part_name_problem(name):
        one.at.fail(
            f"camera {rig_part_name_problem(name)}: --set cameras.names.{one.name}=cam0 gives it another", value=name
        )
    return name


def _anchor(
    named: dict[str, ForeignCamera], known: dict[str, Camera], stated: Cameras, file: Path
) -> tuple[RigidTransform | None, tuple[str, ...]]:
    """(T_base_reference of a file's cameras, sentences); None where it tells no places."""
    placed = {name: one.T for name, one in named.items() if one.T is not None}
    if not placed:
        return None, ()
    if stated.at is not None:
        name, T = next(iter(placed.items()))
        return _pose(stated.at) * T.inv(), (f"camera {name} is placed as cameras.at states",)
    name = next((name for name in placed if name in known), "")
    if not name:
        raise RigError(
            f"{file}: the relative poses of its cameras are stated, but not those in the base frame: --set "
            "'cameras.at=X Y Z RX RY RZ' "
            f"places {next(iter(placed))} (camera in base, m and rad, x right, y down, z ahead)"
        )
    return known[name].pose * placed[name].inv(), (
        f"camera {name} is placed as rig.toml states, the others as {file.name} states them relative to it",
    )


def _pose(text: str) -> RigidTransform:
    try:
        figures = parse_numbers(text.replace(",", " ").split())
    except ValueError:
        figures = []
    if len(figures) != 6 or not np.isfinite(figures).all() or np.abs(figures[:3]).max() > LARGEST_RIG:
        raise RigError(f"cameras.at takes six figures, x y z rx ry rz in m and rad, not {short_repr(text)}")
    return pose(figures[:3], figures[3:])


def _camera(name: str, one: ForeignCamera, known: Camera | None, T_base: RigidTransform | None) -> Camera:
    """The camera as rig.toml will have it. known : of that name, or None"""
    placed = None if one.T is None or T_base is None else T_base * one.T
    if known is not None:
        if one.size not in (None, (known.width, known.height)):
            width, height = one.size or (0, 0)
            one.at.fail(
                f"camera {name} was calibrated at {width}x{height} px, and rig.toml has "
                f"{known.width}x{known.height}: a lens holds for one "
                "size of image"
            )
        return replace(
            known, matrix=one.matrix, distortion=one.distortion, pose=known.pose if placed is None else placed
        )
    if placed is None or one.size is None:
        lacks = "where it stands" if placed is None else "its size"
        one.at.fail(
            f"camera {name} is not in rig.toml, and {one.at.file.name} does not state {lacks}: write a "
            "[[camera]] of that name with the pose "
            "that you believe"
        )
    return Camera(name, *one.size, one.matrix, one.distortion, placed)
