"""Singularity of a hexapod's geometry, and twist of its cardans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.pose import exp

if TYPE_CHECKING:
    pass


SINGULAR = 1e-6  # of the largest singular value of the Jacobian, rotations weighed by the platform's size
MOVES = np.array(
    [[0.1, 0, 0, 0, 0, 0], [0, 0.1, 0, 0.1, 0, 0], [0, 0, 0.1, 0, 0.1, 0], [0, 0, 0, 0, 0, 0.1]]
)  # platform sizes, rad


def singular_geometry_problem(hexapod: Hexapod) -> str | None:
    """Problem of a hexapod that is singular at home or by its architecture, in words.

    None where it is not.

    Joints on similar hexagons, one plate turned against the other or not, leave it loose wherever it stands.
    Sources: Ma and Angeles, Architecture singularities of parallel manipulators, 1992; Merlet, Parallel Robots, 2nd
    ed., ch. 6
    """
    size = max(
        float(np.linalg.norm(hexapod.platform_joints - hexapod.platform_joints.mean(axis=0), axis=1).mean()), 1e-9
    )
    if _least(hexapod, np.zeros(6), size) > SINGULAR:
        return None
    if all(_least(hexapod, move, size) <= SINGULAR for move in MOVES * np.repeat([size, 1.0], 3)):
        return (
            "is singular by its architecture: whatever the strut lengths, the platform is loose at every "
            "pose, since base and platform joints "
            "lie on similar hexagons or the like (Ma and Angeles 1992); set the joints of one plate nearer in pairs"
        )
    return (
        "is singular: there the strut lengths do not hold the platform, and no pose follows from them; another "
        "home is needed, turned or tilted"
    )


def _least(hexapod: Hexapod, move: Floats, size: float) -> float:
    """Least singular value of the Jacobian at home moved by a tangent (m, rad), as a share of the largest; 0 where a
    strut has no length.
    """
    matrix = (hexapod.home * exp(move)).as_matrix()
    R, a = matrix[:3, :3], hexapod.platform_joints
    struts = (a @ R.T + matrix[:3, 3] - hexapod.base_joints) @ R
    lengths = np.linalg.norm(struts, axis=1)
    if lengths.min() <= 0:
        return 0.0
    u = struts / lengths[:, None]
    values = np.linalg.svd(np.hstack([u, np.cross(a, u) / size]), compute_uv=False)
    return float(values[-1] / values[0])


def cardan_twist_angles_about_struts(T: RigidTransform, mechanism: Hexapod) -> Floats:
    """Twist (..., struts) rad of each strut's platform-side cardan against its base-side one, about the strut.

    A cardan's first axis lies in its plate, tangential, (-y, x, 0) of the joint in the plate's frame; its second is
    perpendicular to the first and to the strut. Right-handed about u, from base to platform.
    """
    R = T.rotation.as_matrix()[..., None, :, :]
    u = T.as_matrix()[..., None, :3, 3] + (R @ mechanism.platform_joints[..., None])[..., 0] - mechanism.base_joints
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    base, moved = (
        cardan_plate_axes(mechanism.base_joints),
        (R @ cardan_plate_axes(mechanism.platform_joints)[..., None])[..., 0],
    )
    a, b = np.cross(u, np.broadcast_to(base, u.shape)), np.cross(u, moved)
    return np.arctan2(np.einsum("...i,...i->...", np.cross(a, b), u), np.einsum("...i,...i->...", a, b))


def cardan_plate_axes(joints: Floats) -> Floats:
    """First axes (struts, 3) of the cardans at joints (struts, 3) m of a plate, in its frame.

    Tangential, as long as the joint is off its middle.
    """
    return np.stack([-joints[:, 1], joints[:, 0], np.zeros(len(joints))], axis=1)
