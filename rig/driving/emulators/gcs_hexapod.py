"""Emulated PI hexapod controller (GCS).

C-887: GCS with poses, X Y Z in mm and U V W in degrees, by a geometry of its own.

The controller computes strut lengths from a pose by its nominal geometry. The machine at its struts is built otherwise.
A move takes as long as the platform's origin, and its fastest strut, need at the platform's velocity (VLS).
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.driving.clock import Clock
from rig.driving.emulators.controller_faults import Faults
from rig.driving.emulators.emulated_axis_motion_and_homing import EmulatedMachine
from rig.driving.emulators.gcs import GCS, MM
from rig.driving.protocols.gcs_hexapod import AXES, PIVOT, UNITS, pose_of_gcs_values
from rig.errors import NotConverged
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod

UNKNOWN, VELOCITY, INVALID_AXIS, OUT_OF_LIMITS, WRONG_NUMBER = 2, 8, 15, 7, 25  # errors
NONE = RigidTransform.identity()
FASTEST = 5.0  # times a strut's speed that the platform may move


class GCSHexapod(GCS):
    """Its controller; see rig.driving.emulators.gcs.GCS.

    geometry : its own; limits : (6, 2) m of the struts' counters; work : T_base_work, in which it takes poses of its
        tool, its home by default; tool : T_platform_tool
    """

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        geometry: Hexapod,
        limits: Floats,
        work: RigidTransform | None = None,
        tool: RigidTransform = NONE,
    ) -> None:
        self.geometry, self.work, self.tool = geometry, geometry.home if work is None else work, tool
        self._into_work, self._tool = np.linalg.inv(self.work.as_matrix()), tool.as_matrix()
        self._shown: tuple[Floats, Floats] | None = None  # lengths, and the pose that they make
        super().__init__(machine, faults, clock, AXES, limits)

    def greet(self) -> None:
        self.pivot, self.platform_velocity = np.zeros(3), float(self.machine.axes.speed.min())
        super().greet()

    def line(self, line: bytes) -> None:
        words = line.decode("latin-1").strip().split()
        word = words[0].upper() if words else ""
        if word == "SPI?":
            self.say(" \n".join(f"{name}={MM * value:.6f}" for name, value in zip(PIVOT, self.pivot)) + "\n")
        elif word == "VLS?":
            self.say(f"{MM * self.platform_velocity:.6f}\n")
        elif word == "SPI":
            self._set_pivot(words[1:])
        elif word == "VLS":
            self._set_velocity(words[1:])
        elif word in ("VEL", "ACC", "DEC"):  # of single axes, which a hexapod has none of
            self.error = UNKNOWN
        else:
            super().line(line)

    def pose_values(self) -> Floats:
        """(6,) X Y Z in mm, U V W in degrees, as it computes them from its struts."""
        lengths = self.machine.counters(self.now) + self.machine.zero
        if self._shown is None or not np.array_equal(lengths, self._shown[0]):
            self._shown = lengths, mechanisms.hexapod.forward(lengths, self.geometry).as_matrix()
        T = self._into_work @ self._shown[1] @ self._tool
        R = T[:3, :3]  # Rx(U) Ry(V) Rz(W)
        place = T[:3, 3] + R @ self.pivot - self.pivot
        angles = np.arctan2([-R[1, 2], R[0, 2], -R[0, 1]], [R[2, 2], np.hypot(R[0, 0], R[0, 1]), R[0, 0]])
        return np.r_[MM * place, np.degrees(angles)]

    def _set_pivot(self, arguments: list[str]) -> None:
        names, values = arguments[::2], arguments[1::2]
        if len(arguments) % 2 or not names or set(names) - set(PIVOT):
            self.error = INVALID_AXIS
        elif np.abs(self.pose_values()[3:]).max() > 1e-6:  # only while it is not turned
            self.error = OUT_OF_LIMITS
        else:
            for name, value in zip(names, values):
                self.pivot[PIVOT.index(name)] = float(value) / MM

    def _set_velocity(self, arguments: list[str]) -> None:
        try:
            (value,) = (float(text) / MM for text in arguments)
        except ValueError:
            self.error = WRONG_NUMBER
            return
        if 0 < value <= FASTEST * self.machine.axes.speed.max():
            self.platform_velocity = value
        else:
            self.error = VELOCITY

    def seconds_of_move(self, target: Floats) -> float:
        """s that a move to counters (6,) m takes at the platform's velocity."""
        start = self.machine.counters(self.now)
        ends = [mechanisms.hexapod.forward(one + self.machine.zero, self.geometry) for one in (start, target)]
        way = np.linalg.norm(ends[1].translation - ends[0].translation)
        return float(max(way, np.abs(target - start).max()) / self.platform_velocity)

    def _ask(self, word: str, arguments: list[str]) -> None:
        if word not in ("POS?", "PUN?"):
            super()._ask(word, arguments)
            return
        if any(axis not in AXES for axis in arguments):
            self.error = INVALID_AXIS
            return
        shown = [f"{value:.6f}" for value in self.pose_values()] if word == "POS?" else UNITS
        rows = [f"{axis}={value}" for axis, value in zip(AXES, shown) if not arguments or axis in arguments]
        self.say(" \n".join(rows) + "\n")

    def _set(self, word: str, arguments: list[str]) -> None:
        if word != "MOV":
            super()._set(word, arguments)
            return
        names = arguments[::2]
        if len(arguments) % 2 or not names or set(names) - set(AXES):
            self.error = INVALID_AXIS
            return
        values = self.pose_values()
        try:
            values[[AXES.index(name) for name in names]] = [float(value) for value in arguments[1::2]]
            T = pose_of_gcs_values(values)
            shift = T.translation - T.rotation.apply(self.pivot) + self.pivot
            platform = self.work * RigidTransform.from_components(shift, T.rotation) * self.tool.inv()
            lengths = mechanisms.hexapod.inverse(platform, self.geometry)
        except (ValueError, NotConverged):
            self.error = WRONG_NUMBER
            return
        self._move(lengths - self.machine.zero, list(range(6)))
