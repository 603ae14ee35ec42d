"""Derivatives of the axes of a user's kinematics file, by pose and by parameters."""

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.model.user_kinematics_file import STEP, KinematicsFile


def finite_difference_step(tolerance: float) -> float:
    """Step of finite differences for a parameter with a tolerance, in its unit."""
    return 0.4 * tolerance if tolerance else STEP


def axis_change_columns_by_freedom(file: KinematicsFile, poses: Floats, parameters: Floats) -> Floats:
    """Columns (n, axes, freedoms) of the axes' change with the freedoms.

    m or rad, along and about the base's axes, at poses (n, 4, 4).
    """
    out = np.empty((len(poses), len(file.axes), len(file.freedoms)))
    for k, freedom in enumerate(file.freedoms):

        def moved(s: float | complex, freedom: int = freedom) -> Floats:
            at = poses.astype(type(s) if isinstance(s, complex) else float)
            if freedom < 3:
                at[:, freedom, 3] += s
                return file.inverse(at, parameters)
            at[:, :3, :3] = _turn(freedom - 3, s) @ poses[:, :3, :3]
            return file.inverse(at, parameters)

        out[..., k] = file.derivative(moved)
    return out


def axis_change_columns_by_parameter(
    file: KinematicsFile, poses: Floats, parameters: Floats, parameter_indices: Integers
) -> Floats:
    """Columns (n, axes, k) of the axes' change with parameters.

    Those of `parameter_indices` (k,), in their units.
    """
    out = np.empty((len(poses), len(file.axes), len(parameter_indices)))
    tolerances = file.tolerances
    for k, j in enumerate(parameter_indices.tolist()):

        def moved(s: float | complex, j: int = j) -> Floats:
            q = parameters.astype(type(s) if isinstance(s, complex) else float)
            q[j] += s
            return file.inverse(poses, q)

        out[..., k] = file.derivative(moved, finite_difference_step(float(tolerances[j])))
    return out


def _turn(axis: int, angle: float | complex) -> Floats:
    """(3, 3) rotation about a base axis, of a real or complex angle."""
    out = np.eye(3, dtype=type(angle) if isinstance(angle, complex) else float)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i] = out[j, j] = np.cos(angle)
    out[j, i] = np.sin(angle)
    out[i, j] = -out[j, i]
    return out
