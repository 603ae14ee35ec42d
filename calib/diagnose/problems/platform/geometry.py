"""The geometry that calibration frees, of each kind of platform: its parameters, and how struts' closures change with them."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.identify.geometry import PRIOR, loop_jacobian, parameters, with_parameters
from rig.design import Hexapod, Planar2
from rig.mechanisms import hexapod, planar

Platform = Hexapod | Planar2

__all__ = ["PRIOR", "Platform", "closure_jacobian", "count", "geometry", "moved_by", "pose_jacobian"]


def count(mechanism: Platform) -> int:
    """How many parameters a mechanism's geometry has: joints' coordinates and struts' zeros."""
    return mechanism.base_joints.size + (mechanism.platform_joints.size if mechanism.kind == "hexapod" else 0) + len(mechanism.strut_zeros)


def geometry(mechanism: Platform) -> np.ndarray:
    """(p,) m, the parameters: base joints, platform joints where there are any, zeros."""
    if mechanism.kind == "hexapod":
        return parameters(mechanism)
    return np.concatenate([mechanism.base_joints.ravel(), mechanism.strut_zeros])


def moved_by(mechanism: Platform, step: np.ndarray) -> Platform:
    """The mechanism with its parameters changed by a step (p,) m."""
    p = geometry(mechanism) + step
    if mechanism.kind == "hexapod":
        return with_parameters(mechanism, p)
    return replace(mechanism, base_joints=p[:4].reshape(2, 2), strut_zeros=p[4:])


def pose_jacobian(T_base_platform: RigidTransform, mechanism: Platform) -> np.ndarray:
    """(F, axes, 6) m/m and m/rad, change of the struts' lengths with the poses' tangents on the right."""
    if mechanism.kind == "hexapod":
        return hexapod.jacobian(T_base_platform, mechanism)
    return planar.jacobian(T_base_platform, mechanism)


def closure_jacobian(T_base_platform: RigidTransform, mechanism: Platform) -> np.ndarray:
    """(F, axes, p) change of the struts' closures, zero - length, with the parameters (m/m) at poses (F,)."""
    if mechanism.kind == "hexapod":
        return loop_jacobian(T_base_platform, mechanism)
    struts = T_base_platform.translation[..., None, :2] - mechanism.base_joints
    u = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    out = np.zeros((*u.shape[:-1], 6))
    for i in range(2):
        out[..., i, 2 * i : 2 * i + 2] = u[..., i, :]
        out[..., i, 4 + i] = 1
    return out
