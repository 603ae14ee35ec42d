"""Poses of an emulated hexapod's own controller, by a geometry and frames of its own."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import MM, poses_of_xyz_mm_uvw_degrees
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod


class EmulatedPlatform:
    """geometry : the controller's own; work : T_base_work, in which it takes poses of its tool, its home by default;
    tool : T_platform_tool, None for the platform itself; angles : "moving" or "fixed", the axes that U, V, W turn about
    pivot : (3,) m, about which it turns
    """

    def __init__(
        self, geometry: Hexapod, work: RigidTransform | None, tool: RigidTransform | None, angles: str = "moving"
    ) -> None:
        self.geometry, self.pivot, self.angles = geometry, np.zeros(3), angles
        self.work = geometry.home if work is None else work
        self.tool = RigidTransform.identity() if tool is None else tool
        self._shown: tuple[Floats, Floats] | None = None  # lengths, and the pose that they make

    def values(self, lengths: Floats) -> Floats:
        """(6,) X Y Z in mm, U V W in degrees, as it computes them from the lengths (6,) m of its struts."""
        if self._shown is None or not np.array_equal(lengths, self._shown[0]):
            self._shown = lengths, mechanisms.hexapod.forward(lengths, self.geometry).as_matrix()
        T = np.linalg.inv(self.work.as_matrix()) @ self._shown[1] @ self.tool.as_matrix()
        R = T[:3, :3]  # Rx(U) Ry(V) Rz(W), or Rz(W) Ry(V) Rx(U)
        place = T[:3, 3] + R @ self.pivot - self.pivot
        if self.angles == "moving":
            angles = np.arctan2([-R[1, 2], R[0, 2], -R[0, 1]], [R[2, 2], np.hypot(R[0, 0], R[0, 1]), R[0, 0]])
        else:
            angles = np.arctan2([R[2, 1], -R[2, 0], R[1, 0]], [R[2, 2], np.hypot(R[0, 0], R[1, 0]), R[0, 0]])
        return np.r_[MM * place, np.degrees(angles)]

    def lengths(self, values: Floats) -> Floats:
        """(6,) m of the struts that give X .. W (6,). Raises ValueError, NotConverged where nothing does."""
        T = poses_of_xyz_mm_uvw_degrees(values, self.angles)
        shift = T.translation - T.rotation.apply(self.pivot) + self.pivot
        platform = self.work * RigidTransform.from_components(shift, T.rotation) * self.tool.inv()
        return mechanisms.hexapod.inverse(platform, self.geometry)
