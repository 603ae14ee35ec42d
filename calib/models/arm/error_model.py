"""Error model of an arm: Jacobians of the measured pose by geometric parameters and by joints.

Parameters stand in one vector of 12 + 5 n: the base (where the arm stands in the instrument's frame; tangent x y z rx
ry rz on the right, m and rad), then theta, d, a, alpha, beta of every row (rad, m, m, rad, rad), then the tool (where
the target sits on the last link; tangent on the right). To first order the target's pose moves by tangent =
J_parameters dp + J_joints dq.
Source: lecture on the manipulator Jacobian, eqs 4.63 and 4.64 (d = M_theta dtheta + M_d dd + M_a da + M_alpha dalpha +
M_beta dbeta and the rotational rows); Hayati, CDC 1983.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.arrays import Floats, Integers
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.pose import exp, pose_difference, skew

ROW = ("theta", "d", "a", "alpha", "beta")
TANGENT = ("x", "y", "z", "rx", "ry", "rz")


def joint_zeros(arm: Arm) -> Floats:
    """Joint zeros (n,) rad, m for slides: the offset of each joint's value in its row, theta or d."""
    return np.where(arm.slides, arm.rows[:, 1], arm.rows[:, 0])


def joint_zero_indices(arm: Arm) -> Integers:
    """Index (n,) of each joint's zero among the parameters."""
    return 6 + 5 * np.arange(len(arm.joints)) + arm.slides


def parameter_names(arm: Arm) -> tuple[str, ...]:
    """Names of the parameters, in order: base x .. base rz, theta 1, d 1, a 1, alpha 1, beta 1, theta 2 .., tool x ..
    tool rz.
    """
    rows = [f"{name} {i + 1}" for i in range(len(arm.joints)) for name in ROW]
    return tuple([f"base {name}" for name in TANGENT] + rows + [f"tool {name}" for name in TANGENT])


def parameter_units(arm: Arm) -> tuple[str, ...]:
    """Unit of each parameter, "m" or "rad"."""
    ends = ["m"] * 3 + ["rad"] * 3
    return tuple(ends + ["rad", "m", "m", "rad", "rad"] * len(arm.joints) + ends)


def arm_with_parameter_step(arm: Arm, step: Floats) -> Arm:
    """Arm with its parameters changed by a step (12 + 5 n,)."""
    rows = arm.rows + np.reshape(step[6:-6], (-1, 5))
    return replace(arm, base=arm.base * exp(step[:6]), joints=rows, tool=arm.tool * exp(step[-6:]))


def predicted_target_poses(q: Floats, arm: Arm) -> RigidTransform:
    """Predicted poses (...) of the instrument's target in the instrument's frame, at joint values q (..., n)."""
    return mechanism.forward(q, arm)


def pose_residuals(q: Floats, T_measured: RigidTransform, arm: Arm) -> Floats:
    """Pose residuals (..., 6) m, rad: measured against predicted, in the predicted target frame."""
    return pose_difference(predicted_target_poses(q, arm), T_measured)


def joint_jacobian(q: Floats, arm: Arm) -> Floats:
    """Joint Jacobian (..., 6, n): change of the target's pose (m, rad) with joint values q (..., n)."""
    return mechanism.jacobian(q, arm)


def parameter_jacobian(q: Floats, arm: Arm) -> Floats:
    """Parameter Jacobian (..., 6, 12 + 5 n): change of the target's pose (m, rad) with the parameters.

    q : (..., n) rad or m. At the tool the columns are the identity; all others are axis x lever over axis, seen in the
        target.
    """
    chain = mechanism.frames(q, arm)
    n = len(arm.joints)
    R, p = chain[..., -1, :3, :3], chain[..., -1, :3, 3]
    before, after = chain[..., :n, :, :], chain[..., 1 : n + 1, :, :]
    rows = arm.rows
    turn = (mechanism.joint_rotations(q, arm) + rows[:, 0])[..., None]
    along = (
        np.cos(turn) * before[..., :3, 0] + np.sin(turn) * before[..., :3, 1]
    )  # the common normal, x of the turned frame
    across, origin = after[..., :3, 1], after[..., :3, 3]
    z = before[..., :3, 2]
    lever = p[..., None, :] - origin
    out = np.zeros((*p.shape[:-1], 12 + 5 * n, 6))  # columns as rows first
    out[..., :6, :] = _at_base(chain[..., 0, :3, :3], p - chain[..., 0, :3, 3])
    joints = out[..., 6:-6, :].reshape(*p.shape[:-1], n, 5, 6)
    joints[..., 0, :3], joints[..., 0, 3:] = np.cross(z, p[..., None, :] - before[..., :3, 3]), z
    joints[..., 1, :3] = z
    joints[..., 2, :3] = along
    joints[..., 3, :3], joints[..., 3, 3:] = np.cross(along, lever), along
    joints[..., 4, :3], joints[..., 4, 3:] = np.cross(across, lever), across
    out[..., 6:-6, :] = joints.reshape(*p.shape[:-1], 5 * n, 6)
    out[..., :3], out[..., 3:] = out[..., :3] @ R, out[..., 3:] @ R
    out[..., -6:, :] = np.eye(6)
    return np.swapaxes(out, -1, -2)


def _at_base(R: Floats, lever: Floats) -> Floats:
    """(..., 6, 6), one parameter a row: the base's tangent on its right, seen in the frame of poses; lever (..., 3)
    m.
    """
    out = np.zeros((*lever.shape[:-1], 6, 6))
    out[..., :3, :3] = np.swapaxes(R, -1, -2)
    out[..., 3:, :3] = np.swapaxes(R, -1, -2) @ skew(lever)
    out[..., 3:, 3:] = np.swapaxes(R, -1, -2)
    return out
