"""Protocol of a PI hexapod's own controller (GCS).

C-887: GCS 2.0 with poses, X Y Z in mm and U V W in degrees.

The controller computes strut lengths from a pose by its nominal geometry, that of rig.toml. So lengths that are wanted
are commanded as the pose of which this geometry makes them, in the controller's frames and about its pivot point, and
the pose that is read back stands for lengths. The pivot point (SPI) is asked of the controller before every move.
Source: PI MS204E (C-887), MOV, POS?, SPI, VLS; poses: PI MS207E (H-820), 3.7.4; work and tool frames: C887T0007
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.gcs import GCS
from rig.driving.protocols.protocol_interface import Dialogue, Segment, Verdict
from rig.errors import ControllerFault
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.pose import pose

AXES = ("X", "Y", "Z", "U", "V", "W")
PIVOT = ("R", "S", "T")  # names of the pivot point's coordinates
UNITS = ("MM",) * 3 + ("DEG",) * 3
NONE = pose([0, 0, 0], [0, 0, 0])
ORDER, MM = "XYZ", 1e3  # of SciPy: about axes that move along, in the order U, V, W; per m


def gcs_values_of_pose(T: RigidTransform) -> Floats:
    """GCS values (..., 6) of poses (...), as a hexapod's controller takes them.

    X, Y, Z in mm and U, V, W in degrees.
    """
    return np.concatenate([MM * T.translation, T.rotation.as_euler(ORDER, degrees=True)], axis=-1)


def pose_of_gcs_values(values: ArrayLike) -> RigidTransform:
    """Poses (...) of (..., 6) X, Y, Z in mm and U, V, W in degrees."""
    values = np.asarray(values, float)
    return RigidTransform.from_components(
        values[..., :3] / MM, Rotation.from_euler(ORDER, values[..., 3:], degrees=True)
    )


@dataclass(frozen=True, slots=True, eq=False)
class PoseFrames:
    """Frames in which a controller takes poses. work : T_base_work; tool : T_platform_tool; pivot : (3,) m in the
    tool's frame: the point that a turn leaves where it is (SPI); gcs : whether poses are written as MOV takes them
    """

    work: RigidTransform = NONE
    tool: RigidTransform = NONE
    pivot: Floats = field(default_factory=lambda: np.zeros(3))
    gcs: bool = False

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


class GCSHexapod(GCS):
    """See rig.driving.protocols.protocol_interface.Protocol; its positions are the struts' lengths.

    hexapod : the geometry by which the controller computes; zero : (6,) m, lengths that are called 0
    work : T_base_work, None for the platform at home; tool : T_platform_tool, None for the platform itself
    """

    name = "gcs-hexapod"

    def __init__(
        self, hexapod: Hexapod, zero: Floats, work: RigidTransform | None, tool: RigidTransform | None
    ) -> None:
        super().__init__(AXES, len(AXES))
        self.hexapod, self.zero = hexapod, zero
        self.frames = PoseFrames(hexapod.home if work is None else work, NONE if tool is None else tool)

    def hello(self) -> Dialogue[str]:
        said = yield from super().hello()
        yield from self._learn_pivot()
        return f"{said}, pivot point {' '.join(f'{MM * value:g}' for value in self.frames.pivot)} mm"

    def fence(self) -> Dialogue[bool]:
        same = yield from super().fence()
        yield from self._learn_pivot()
        return same

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        ends = np.stack([segment.start, segment.target]) + self.zero
        start, T = mechanisms.hexapod.forward(ends, self.hexapod)
        way = max(np.linalg.norm(T.translation - start.translation), np.abs(np.diff(ends, axis=0)).max())
        if way > 0:  # the platform's velocity, with which the fastest strut has the speed that is asked for
            verdict = yield from self._command(f"VLS {MM * way / segment.duration:.6f}")
            if not verdict.accepted:
                return verdict
        values = gcs_values_of_pose(self.frames.command_of_pose(T))
        return (yield from self._command("MOV " + " ".join(f"{a} {value:.6f}" for a, value in zip(AXES, values))))

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        return None  # what TMN? and TMX? say is of each coordinate alone, the others at 0, and not of struts

    def _positions(self) -> Dialogue[Floats]:
        values = yield from self._values("POS?")
        T = self.frames.pose_of_command(pose_of_gcs_values(values))
        return mechanisms.hexapod.inverse(T, self.hexapod) - self.zero

    def _learn_unit(self) -> Dialogue[None]:
        stated = yield from self._readings("PUN?", AXES, r"\S+")
        found = tuple(stated[axis].upper() for axis in AXES)
        if found != UNITS:
            raise ControllerFault(
                f"its axes X Y Z U V W count in {' '.join(found)}, and those of a hexapod's controller in "
                f"{' '.join(UNITS)}: is [controller] protocol right?"
            )

    def _learn_pivot(self) -> Dialogue[None]:
        """Learn about which point the platform turns: it may be another since."""
        found = yield from self._readings("SPI?", PIVOT)
        at = np.array([float(found[name]) for name in PIVOT]) / MM
        self.frames = PoseFrames(self.frames.work, self.frames.tool, at)
