"""How far the cardans at a hexapod's struts are twisted against each other."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.model.design import Hexapod


def cardan_twist(T: RigidTransform, mechanism: Hexapod) -> np.ndarray:
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


def _tangential(joints: np.ndarray) -> np.ndarray:
    return np.stack([-joints[:, 1], joints[:, 0], np.zeros(len(joints))], axis=1)
