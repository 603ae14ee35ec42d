"""Geometry, compensation and camera files for other programs: JSON, CSV, LinuxCNC, ROS and OpenCV.


Source: ROS, camera_calibration_parsers, sensor_msgs/CameraInfo and distortion_models.hpp; OpenCV, FileStorage

In LinuxCNC a strut's joint position is its whole length, joint centre to joint centre, plus the screw's correction; the
components `offset`, one per strut, take the zeros off on the way to the motor, so that it is told what it would be
told here. Source: genhexkins(9), offset(9) of LinuxCNC.

LinuxCNC adds to a joint's position what its table has there, nominal less actual, joined by straight lines; a file of
COMP_FILE_TYPE 0 has a line for each nominal position: it, the actual position going up, and going down. Source:
LinuxCNC, INI configuration, [JOINT_n] COMP_FILE
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.model.design import Camera
from rig.model.mechanism_geometry_classes import Arm, FileMechanism, Hexapod
from rig.model.mechanisms.hexapod import cardan_twist_angles_about_struts
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_hexapod
from rig.model.pose import pose_file_entry, pose_to_vector

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
PARAMETER = ("parameter", "unit", "stated", "value")
ARM = ("joint", "theta", "d", "a", "alpha", "beta", "lowest", "highest", "slides")


def _parameter_rows(mechanism: FileMechanism) -> list[tuple[str, str, float, float]]:
    """(name, unit, as the owner states it, value) of each parameter of a kinematics file, m or rad."""
    stated = mechanism.stated
    return list(zip(stated.names, stated.units, stated.nominal.tolist(), mechanism.parameters.tolist()))


def geometry_json(mechanism: Hexapod | Arm | FileMechanism) -> str:
    """Geometry of a mechanism as JSON.

    Of a Hexapod or an Arm, or the parameters of a kinematics file by name.
    """
    tree: Json
    if isinstance(mechanism, FileMechanism):
        rows = (dict(zip(PARAMETER, row)) for row in _parameter_rows(mechanism))
        tree = {"file": Path(mechanism.file).name, "sha256": mechanism.stated.sha256, "parameters": list(rows)}
    elif is_hexapod(mechanism):
        tree = {
            name: getattr(mechanism, name).tolist()
            for name in ("base_joints", "platform_joints", "strut_zeros", "strut_range")
        }
        tree["home"] = pose_file_entry(mechanism.home)
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


def geometry_csv(mechanism: Hexapod | Arm | FileMechanism) -> str:
    """Geometry as CSV.

    A row per strut of a Hexapod, a row per joint of an Arm, a row per parameter of a kinematics file.
    """
    if isinstance(mechanism, FileMechanism):
        lines = [f"{name},{unit},{old:.12f},{new:.12f}" for name, unit, old, new in _parameter_rows(mechanism)]
        return "\n".join([",".join(PARAMETER), *lines]) + "\n"
    header: tuple[str, ...]
    parts: Iterable[tuple[Floats, ...]]
    if is_hexapod(mechanism):
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
    """ROS camera_info YAML of a Camera.

    Raises RigError for a lens that ROS has no model of.
    """
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


UNITS = {"mm": 1e3, "m": 1.0}
DIGITS = 12  # decimals of a machine unit
CONVERGED = 1e-12  # m; what its iteration may leave of a strut
STEEPEST = np.pi / 2 - 0.05  # rad; genhexkins takes the arc sine of a joint's twist, so a quarter turn is the end


def genhexkins_settings(
    hexapod: Hexapod, units: str = "mm", screw_lead: float | None = None, screw_coupling: float = 0.0
) -> str:
    """LinuxCNC genhexkins settings (HAL) of a Hexapod.

    units : of the machine, "mm" or "m"; screw_lead : m per revolution of the screws; screw_coupling : share of a
        cardan's twist that
    turns the nut (the effect screw_coupling; 0: none, and genhexkins' correction stays off)
    Raises ValueError for other units, RigError where a coupling is asked for that genhexkins cannot express
    """
    if units not in UNITS:
        raise ValueError(f"units are {' or '.join(UNITS)}, not {units!r}")
    scale = UNITS[units]
    zeros, sign = hexapod.strut_zeros, np.ones(6)
    if screw_coupling:
        if screw_lead is None:
            raise RigError("a coupling of the screws needs their lead, m per revolution")
        twist = cardan_twist_angles_about_struts(hexapod.home, hexapod)
        sign = np.where(
            np.abs(twist) > np.pi / 2, -1.0, 1.0
        )  # the platform's axis the other way round is the same axis
        turned = twist - np.where(sign < 0, np.copysign(np.pi, twist), 0)
        if np.abs(turned).max() > STEEPEST - 0.5:
            i = int(np.argmax(np.abs(turned)))
            raise RigError(
                f"strut {i + 1}: its cardans stand at {np.degrees(turned[i]):.0f} degrees to each other at "
                "home; genhexkins' correction "
                "ends at 90"
            )
        zeros = zeros - screw_coupling * screw_lead / (2 * np.pi) * turned
    lines = [
        f"# machine units: {units}; joint N is the length of strut N + 1, joint centre to joint centre",
        "loadrt genhexkins",
        "loadrt offset count=6",
        "",
    ]
    for name, points in (("base", hexapod.base_joints), ("platform", hexapod.platform_joints)):
        lines += _vectors(name, points * scale)
    lines += [
        "",
        f"setp genhexkins.screw-lead {-screw_coupling * (screw_lead or 0.0) * scale:.{DIGITS}f}",
        f"setp genhexkins.convergence-criterion {CONVERGED * scale:.0e}",
    ]
    if screw_coupling:
        lines += _vectors("base-n", _tangential(hexapod.base_joints))
        lines += _vectors("platform-n", sign[:, None] * _tangential(hexapod.platform_joints))
    lines += [
        "",
        "# joint.N.motor-pos-cmd -> offset.N.in, offset.N.out -> the strut's motor; motor position -> offset.N.fb-in, "
        "offset.N.fb-out -> joint.N.motor-pos-fb",
    ]
    lines += [f"setp offset.{i}.offset {-zero * scale:.{DIGITS}f}" for i, zero in enumerate(zeros)]
    lines += ["", "# for the INI file, [JOINT_N]"]
    for i, (low, high) in enumerate(hexapod.strut_range + zeros[:, None]):
        lines.append(f"# {i}: MIN_LIMIT = {low * scale:.6f}  MAX_LIMIT = {high * scale:.6f}")
    return "\n".join(lines) + "\n"


def _vectors(name: str, points: Floats) -> list[str]:
    return [
        f"setp genhexkins.{name}.{i}.{axis} {value:.{DIGITS}f}"
        for i, point in enumerate(points)
        for axis, value in zip("xyz", point)
    ]


def _tangential(joints: Floats) -> Floats:
    axes = np.stack([-joints[:, 1], joints[:, 0], np.zeros(len(joints))], axis=1)
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


MOST = 256  # entries that LinuxCNC takes
SCALE = {"mm": 1e3, "m": 1.0}


def linuxcnc_compensation_file(joint_positions: Floats, corrections: Floats, units: str = "mm") -> str:
    """LinuxCNC compensation file of one joint: corrections (n,) m at joint positions (n,) m.

    units : of the machine, "mm" or "m". Raises ValueError for more entries than it takes, or none that grow
    """
    if not 2 <= len(joint_positions) <= MOST or not (np.diff(joint_positions) > 0).all():
        raise ValueError(f"a joint's table has 2 to {MOST} positions that grow, got {len(joint_positions)}")
    rows = (
        np.column_stack([joint_positions, joint_positions - corrections, joint_positions - corrections]) * SCALE[units]
    )
    return "\n".join(" ".join(f"{value:.9f}" for value in row) for row in rows) + "\n"


def correction_grid_csv(configurations: Floats, corrections: Floats, axes: tuple[str, ...], unit: str) -> str:
    """CSV of corrections (n, axes) on a grid of configurations (n, axes).

    With comment lines that explain them.
    unit : of both, "m" or "rad".
    """
    lines = [
        f"# command = x + k: where the nominal model says x, x + k is to be commanded; unit of both {unit}; "
        "between rows n-linear",
        f"# x: {' '.join(axes)} as commands.csv has them; the last axis runs fastest",
        ",".join([*(f"x_{axis}" for axis in axes), *(f"k_{axis}" for axis in axes)]),
    ]
    lines += [",".join(f"{value:.12f}" for value in row) for row in np.column_stack([configurations, corrections])]
    return "\n".join(lines) + "\n"
