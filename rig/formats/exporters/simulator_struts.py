"""A hexapod's struts as simulators have them: a universal joint at the base, a slide along the strut, a ball at the
platform; frames at home.

A strut's frame stands in its base joint: x along the cardan's first axis, which lies in the base plate, tangential,
(-y, x, 0) of the joint; y, the second, perpendicular to it and to the strut at home; tilted about y by a fixed angle, z
runs along the strut.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.errors import RigError
from rig.model.design import Hexapod

LEAST = 1e-9  # m or rad


@dataclass(frozen=True, slots=True, eq=False)
class Strut:
    """T_base_cross : at home, x and y its two axes; tilt : rad, about y from there to the strut; home : m, joint to
    joint; zero : m, of what is commanded, home less zero; limits : (2,) m, as commanded; T_platform_joint : unrotated
    to the platform"""

    T_base_cross: RigidTransform
    tilt: float
    home: float
    zero: float
    limits: np.ndarray
    T_platform_joint: RigidTransform

    def T_base_strut(self) -> RigidTransform:
        """z along the strut, at home."""
        return self.T_base_cross * RigidTransform.from_rotation(Rotation.from_rotvec([0, self.tilt, 0]))


def simulator_struts(hexapod: Hexapod) -> list[Strut]:
    """The Struts of a Hexapod. Raises RigError for a base joint on the z axis, or a strut along its cardan's first
    axis: no cardan is there.
    """
    found = []
    ends = hexapod.home.apply(hexapod.platform_joints)
    for i, (base, end) in enumerate(zip(hexapod.base_joints, ends)):
        along = (end - base) / np.linalg.norm(end - base)
        first = np.array([-base[1], base[0], 0.0])
        if np.linalg.norm(first) < LEAST:
            raise RigError(
                f"strut {i + 1}: its base joint lies on the z axis, so that a cardan's tangential axis has no direction"
            )
        first /= np.linalg.norm(first)
        second = np.cross(along, first)
        if np.linalg.norm(second) < LEAST:
            raise RigError(f"strut {i + 1} runs along its cardan's first axis at home")
        second /= np.linalg.norm(second)
        R = np.column_stack([first, second, np.cross(first, second)])
        inside = R.T @ along  # no y: the second axis is perpendicular to the strut
        found.append(
            Strut(
                RigidTransform.from_components(base, Rotation.from_matrix(R)),
                float(np.arctan2(inside[0], inside[2])),
                float(np.linalg.norm(end - base)),
                float(hexapod.strut_zeros[i]),
                np.array(hexapod.strut_range[i]),
                RigidTransform.from_translation(hexapod.platform_joints[i]),
            )
        )
    return found
