"""Somebody knocked one camera."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class CameraBump(Effect):
    """The mount is moved by motion (6) m, rad, in the camera's frame, from time (s from the recording's start) on."""

    place: str
    motion: tuple[float, ...] = (0.0,) * 6
    time: float = 0.0
    name: ClassVar = "camera_bump"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (Parameter("motion", "m, rad", (-0.1, 0.1), (1e-5, 1e-3), 6), Parameter("time", "s", (-1e9, 1e9), (0, 1e5), role="moment"))
    sudden: ClassVar = True
    experiment: ClassVar = "fixed cubes in view of that camera before and after"

    def mount(self, camera, t, channel):
        return ((np.asarray(t) >= self.time) * float(self.at(f"camera {camera.name}")))[:, None] * np.asarray(self.motion, float)
