"""Forces and joint axes of a hexapod at its poses, as load and cardan effects need them."""

import numpy as np

from rig.errors import RigError
from rig.mechanisms import hexapod


def axial_forces(motion):
    """(n, 6) N with which each strut pushes the platform, in static equilibrium under gravity with payload.

    Balance of forces and moments on the platform: J^T f + w = 0, w the weight's wrench in the platform frame.
    Source: Merlet, Parallel Robots, 2nd ed., ch. 9. Raises RigError where the platform's mass or centre is not stated
    """
    platform = motion.platform
    if platform.mass is None or platform.centre_of_mass is None:
        raise RigError("load effects need [platform] mass and centre_of_mass in rig.toml")
    payload = motion.payload()
    if payload.any() and platform.payload_centre_of_mass is None:
        raise RigError("a payload was logged, so load effects need [platform] payload_centre_of_mass in rig.toml")
    R = motion.T.rotation.as_matrix()
    down = np.swapaxes(R, 1, 2) @ motion.gravity  # acceleration in the platform frame
    wrench = np.concatenate([platform.mass * down, np.cross(platform.centre_of_mass, platform.mass * down)], axis=1)
    if payload.any():
        weight = payload[:, None] * down
        wrench += np.concatenate([weight, np.cross(platform.payload_centre_of_mass, weight)], axis=1)
    J = hexapod.jacobian(motion.T, motion.mechanism)
    return np.linalg.solve(np.swapaxes(J, 1, 2), -wrench[..., None])[..., 0]


def cardan_twist(T, mechanism):
    """(..., 6) rad by which the platform-side cardan of each strut is turned against the base-side one about the strut.

    A cardan's first axis lies in its plate, tangential, (-y, x, 0) of the joint in the plate's frame; its second is
    perpendicular to the first and to the strut. Right-handed about u, from base to platform.
    """
    R = T.rotation.as_matrix()[..., None, :, :]
    u = T.as_matrix()[..., None, :3, 3] + (R @ mechanism.platform_joints[..., None])[..., 0] - mechanism.base_joints
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    base, moved = _tangential(mechanism.base_joints), (R @ _tangential(mechanism.platform_joints)[..., None])[..., 0]
    a, b = np.cross(u, np.broadcast_to(base, u.shape)), np.cross(u, moved)
    return np.arctan2(np.einsum("...i,...i->...", np.cross(a, b), u), np.einsum("...i,...i->...", a, b))


def _tangential(joints):
    return np.stack([-joints[:, 1], joints[:, 0], np.zeros(len(joints))], axis=1)
