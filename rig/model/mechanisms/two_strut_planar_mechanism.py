"""Planar mechanism of two struts to one hinge.

Plane z = 0: kinematics of the configuration-space patent's example.
"""

from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import NotConverged
from rig.model.mechanism_geometry_classes import Planar2

AXIS, UNIT = "strut", "m"


def inverse(T_base_platform: RigidTransform, planar: Planar2) -> Floats:
    """Inverse kinematics: commanded strut lengths (..., 2) m of a pose (...), from its x and y."""
    position = T_base_platform.translation[..., None, :2]
    return np.linalg.norm(position - planar.base_joints, axis=-1) - planar.strut_zeros


def jacobian(T_base_platform: RigidTransform, planar: Planar2) -> Floats:
    """Jacobian of the strut lengths by the pose.

    Returns (..., 2, 6), by the pose's tangent on the right
    """
    matrix = T_base_platform.as_matrix()
    struts = matrix[..., None, :2, 3] - planar.base_joints
    u = np.zeros((*struts.shape[:-1], 3))
    u[..., :2] = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    J = np.zeros((*struts.shape[:-1], 6))
    J[..., :3] = u @ matrix[..., :3, :3]
    return J


def forward(lengths: Floats, planar: Planar2, guess: RigidTransform | None = None) -> RigidTransform:
    """Forward kinematics: hinge position, unrotated RigidTransform (...), of commanded lengths (..., 2) m.

    guess : unused; the hinge is on the left of the line from base joint 1 to base joint 2
    Raises NotConverged with index, lengths and residual (m) where the circles do not meet
    """
    lengths = np.asarray(lengths, float) + planar.strut_zeros
    line = planar.base_joints[1] - planar.base_joints[0]
    span = np.linalg.norm(line)
    along = (lengths[..., 0] ** 2 - lengths[..., 1] ** 2 + span**2) / (2 * span)
    square = lengths[..., 0] ** 2 - along**2
    apart = np.flatnonzero(np.ravel(square < 0))
    if len(apart):
        pairs = lengths.reshape(-1, 2)[apart]
        residual = np.sqrt(-square.ravel()[apart])
        raise NotConverged(
            f"{len(apart)} of {square.size} pairs of lengths do not meet; first {pairs[0].tolist()} m, "
            f"{residual[0]:.3g} m apart",
            apart,
            pairs,
            residual,
        )
    e = line / span
    position = np.zeros((*lengths.shape[:-1], 3))
    position[..., :2] = (
        planar.base_joints[0] + along[..., None] * e + np.sqrt(square)[..., None] * np.array([-e[1], e[0]])
    )
    return RigidTransform.from_translation(position)


def signed_limit_excess(lengths: Floats, planar: Planar2) -> Floats:
    """Excess of commanded lengths over their limits, (..., 2) m.

    Negative below, positive above, 0 inside.
    """
    low, high = planar.strut_range.T
    return np.minimum(lengths - low, 0) + np.maximum(lengths - high, 0)


def travel_ranges(planar: Planar2) -> Floats:
    """Travel (2, 2) m of the struts.

    Shortest and longest commanded length.
    """
    return planar.strut_range


def home_values(planar: Planar2) -> Floats:
    """Home values (2,) m.

    The strut lengths at the middle of their ranges.
    """
    return planar.strut_range.mean(axis=1)


def axis_forces_and_torques(T: RigidTransform, lengths: Floats, planar: Planar2, wrench: Floats) -> Floats:
    """Axis forces (n, 2) N of the struts that hold a wrench.

    Pushing, with a wrench (n, 6) on the hinge; a guide takes the rest.
    """
    return cast(
        Floats, np.linalg.solve(np.swapaxes(jacobian(T, planar)[..., :2], 1, 2), -wrench[..., :2, None])[..., 0]
    )


def link_weight_loads(T: RigidTransform, lengths: Floats, planar: Planar2, gravity: Floats) -> Floats:
    """Loads of link weight (n, 2, 0), which two struts have none of.

    The mechanism has no arm links, and the base carries the struts.
    """
    return np.zeros((*np.shape(lengths), 0))


def axis_deviation_and_sway_by_member_growth(
    T: RigidTransform, lengths: Floats, planar: Planar2, share: Floats
) -> tuple[Floats, Floats]:
    """Axis deviation (n, 2) m and sway (n, 6) by growth of members, which are struts.

    They grow by shares (n, 2) of their length.

    No sway.
    """
    return share * lengths, np.zeros((len(share), 6))


def inverse_kinematics_jacobian(T: RigidTransform, lengths: Floats, planar: Planar2) -> Floats:
    """Jacobian (n, 2, 6) of strut lengths by the pose's tangent, at poses T (n,)."""
    return jacobian(T, planar)


def jacobian_rows_by_axis(T: RigidTransform, lengths: Floats, planar: Planar2) -> Floats:
    """Rows (n, 2, 6) of the Jacobian, one for each strut.

    One for each strut, at poses T (n,).

    They coincide where the machine is singular.
    """
    return jacobian(T, planar)


def link_points(lengths: Floats, planar: Planar2) -> None:
    """None for any lengths (n, 2) m: two struts have no arm links to draw."""
    return None


def strut_ends(T: RigidTransform, planar: Planar2) -> tuple[Floats, Floats]:
    """Ends of the struts.

    Base joints (2, 3) and the hinge (n, 2, 3) m, base frame, at poses T (n,).
    """
    return np.pad(planar.base_joints, ((0, 0), (0, 1))), np.repeat(T.translation[:, None], 2, axis=1)


def two_strut_loop_jacobian(T_base_platform: RigidTransform, mechanism: Planar2) -> Floats:
    """Loop Jacobian (..., 2, 6) of two struts.

    Change of zero - length with base joints and zeros (m/m).
    """
    struts = T_base_platform.translation[..., None, :2] - mechanism.base_joints
    u = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    out = np.zeros((*u.shape[:-1], 6))
    for i in range(2):
        out[..., i, 2 * i : 2 * i + 2] = u[..., i, :]
        out[..., i, 4 + i] = 1
    return out
