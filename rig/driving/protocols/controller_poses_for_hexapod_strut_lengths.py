"""Poses that hexapods' own controllers take and report in place of strut lengths.

Such a controller computes strut lengths from a pose by its nominal geometry, that of rig.toml. So lengths that are
wanted are commanded as the pose of which this geometry makes them, in the controller's frames and about its pivot
point, and the pose that is read back stands for lengths.

U, V, W turn about axes that move along, in this order: R = Rx(U) Ry(V) Rz(W), which are also called Bryant or Cardan
angles. Of controllers where that is not certain, rig.toml may state axes that stay: R = Rz(W) Ry(V) Rx(U).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import ControllerFault
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.pose import pose
from rig.model.protocol_port_and_user_program_name_checks import ANGLES

AXES = ("X", "Y", "Z", "U", "V", "W")
NONE = pose([0, 0, 0], [0, 0, 0])
MM = 1e3  # per m
EXACT = 1e-6  # mm and degrees by which a coordinate system may differ that is read anew


def xyz_mm_uvw_degrees_of_poses(T: RigidTransform, angles: str = "moving") -> Floats:
    """X, Y, Z in mm and U, V, W in degrees (..., 6) of poses (...). angles : of ANGLES"""
    return np.concatenate([MM * T.translation, T.rotation.as_euler(ANGLES[angles], degrees=True)], axis=-1)


def poses_of_xyz_mm_uvw_degrees(values: ArrayLike, angles: str = "moving") -> RigidTransform:
    """Poses (...) of (..., 6) X, Y, Z in mm and U, V, W in degrees. angles : of ANGLES"""
    values = np.asarray(values, float)
    return RigidTransform.from_components(
        values[..., :3] / MM, Rotation.from_euler(ANGLES[angles], values[..., 3:], degrees=True)
    )


@dataclass(frozen=True, slots=True, eq=False)
class PoseFrames:
    """Frames in which a controller takes poses. work : T_base_work; tool : T_platform_tool; pivot : (3,) m in the
    tool's frame: the point that a turn leaves where it is (SPI); angles : of ANGLES, where poses are written
    as controllers take them, X .. W in mm and degrees; None where in m and as a rotation vector
    """

    work: RigidTransform = NONE
    tool: RigidTransform = NONE
    pivot: Floats = field(default_factory=lambda: np.zeros(3))
    angles: str | None = None

    def command_of_pose(self, T_base_platform: RigidTransform) -> RigidTransform:
        """What is commanded for poses (...): the pose of the tool in the work frame, its translation (m) that of the
        pivot.
        """
        matrix = np.linalg.inv(self.work.as_matrix()) @ T_base_platform.as_matrix() @ self.tool.as_matrix()
        matrix[..., :3, 3] += matrix[..., :3, :3] @ self.pivot - self.pivot
        return RigidTransform(matrix, normalize=False)

    def pose_of_command(self, command: RigidTransform) -> RigidTransform:
        """T_base_platform (...) that a commanded pose (...) means."""
        matrix = command.as_matrix()
        matrix[..., :3, 3] += self.pivot - matrix[..., :3, :3] @ self.pivot
        whole = self.work.as_matrix() @ matrix @ np.linalg.inv(self.tool.as_matrix())
        return RigidTransform(whole, normalize=False)


class PosesForLengths:
    """Poses that stand for the lengths of struts.

    hexapod : the geometry by which the controller computes; zero : (6,) m, lengths that are called 0
    work : T_base_work, None for the platform at home; tool : T_platform_tool, None for the platform itself
    angles : of ANGLES, as U, V, W turn
    """

    def __init__(
        self,
        hexapod: Hexapod,
        zero: Floats,
        work: RigidTransform | None,
        tool: RigidTransform | None,
        angles: str = "moving",
    ) -> None:
        self.hexapod, self.zero, self.angles = hexapod, zero, angles
        self.frames = PoseFrames(hexapod.home if work is None else work, NONE if tool is None else tool)

    def platform(self, positions: Floats) -> RigidTransform:
        """T_base_platform (...) of positions (..., 6) m of the struts."""
        return mechanisms.hexapod.forward(positions + self.zero, self.hexapod)

    def values(self, positions: Floats) -> Floats:
        """X .. W (..., 6), mm and degrees, that are commanded for positions (..., 6) m of the struts."""
        return xyz_mm_uvw_degrees_of_poses(self.frames.command_of_pose(self.platform(positions)), self.angles)

    def positions(self, values: ArrayLike) -> Floats:
        """(..., 6) m, positions of the struts for which X .. W (..., 6), mm and degrees, stand."""
        T = self.frames.pose_of_command(poses_of_xyz_mm_uvw_degrees(values, self.angles))
        return mechanisms.hexapod.inverse(T, self.hexapod) - self.zero


def require_unchanged_coordinate_systems(
    keys: Mapping[str, str], before: Sequence[Floats], now: Sequence[Floats]
) -> None:
    """Raise ControllerFault where a controller's coordinate systems, (6,) mm and degrees each, are others than before.

    keys : of [controller], by the controller's names of its systems, in their order
    """
    for (name, key), was, found in zip(keys.items(), before, now):
        if not np.allclose(was, found, rtol=0, atol=EXACT):
            raise ControllerFault(
                f"another program has set the controller's {name} coordinate system, from {was.tolist()} to "
                f"{found.tolist()} (mm, degrees): state {key} in [controller] as it is now, and connect anew"
            )
