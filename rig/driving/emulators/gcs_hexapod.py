"""Emulated PI hexapod controller (C-887): GCS with poses, X Y Z in mm and U V W in degrees, by a geometry of its own.

The controller computes strut lengths from a pose by its nominal geometry. The machine at its struts is built otherwise.
"""

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.clock import Clock
from rig.driving.emulators.controller_faults import Faults
from rig.driving.emulators.emulated_axis_motion_and_homing import EmulatedMachine
from rig.driving.emulators.gcs import GCS, MM
from rig.driving.protocols.gcs import HEXAPOD_AXES as AXES
from rig.driving.protocols.gcs import gcs_values_of_pose, pose_of_gcs_values
from rig.errors import NotConverged
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod

PIVOT = ("R", "S", "T")  # names of the pivot point's coordinates
INVALID_AXIS, OUT_OF_LIMITS, WRONG_NUMBER = 15, 7, 25  # errors


class GCSHexapod(GCS):
    """Its controller; see rig.driving.emulators.gcs.GCS.

    geometry : its own, which takes poses relative to its home; limits : (6, 2) m of the struts' counters
    """

    def __init__(
        self, machine: EmulatedMachine, faults: Faults, clock: Clock, geometry: Hexapod, limits: Floats
    ) -> None:
        self.geometry, self.pivot = geometry, np.zeros(3)
        super().__init__(machine, faults, clock, AXES, limits)

    def line(self, line: bytes) -> None:
        words = line.decode("latin-1").strip().split()
        if words and words[0].upper() == "SPI?":
            self.say(" \n".join(f"{name}={MM * value:.6f}" for name, value in zip(PIVOT, self.pivot)) + "\n")
        elif words and words[0].upper() == "SPI":
            self._set_pivot(words[1:])
        else:
            super().line(line)

    def pose_values(self) -> Floats:
        """(6,) X Y Z in mm, U V W in degrees, as it computes them from its struts."""
        lengths = self.machine.counters(self.now) + self.machine.zero
        T = self.geometry.home.inv() * mechanisms.hexapod.forward(lengths, self.geometry)
        values = gcs_values_of_pose(T)
        values[:3] += MM * (T.rotation.apply(self.pivot) - self.pivot)
        return values

    def _set_pivot(self, arguments: list[str]) -> None:
        names, values = arguments[::2], arguments[1::2]
        if len(arguments) % 2 or not names or set(names) - set(PIVOT):
            self.error = INVALID_AXIS
        elif np.abs(self.pose_values()[3:]).max() > 1e-6:  # only while it is not turned
            self.error = OUT_OF_LIMITS
        else:
            for name, value in zip(names, values):
                self.pivot[PIVOT.index(name)] = float(value) / MM

    def _ask(self, word: str, arguments: list[str]) -> None:
        if word not in ("POS?", "PUN?"):
            super()._ask(word, arguments)
            return
        if any(axis not in AXES for axis in arguments):
            self.error = INVALID_AXIS
            return
        shown = [f"{value:.6f}" for value in self.pose_values()] if word == "POS?" else ["MM"] * 3 + ["DEG"] * 3
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
            platform = self.geometry.home * type(T).from_components(shift, T.rotation)
            lengths = mechanisms.hexapod.inverse(platform, self.geometry)
        except (ValueError, NotConverged):
            self.error = WRONG_NUMBER
            return
        self._move(lengths - self.machine.zero, list(range(6)))
