"""Camera bump: one camera is knocked at a moment.

It stands elsewhere from then on.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera


@dataclass(frozen=True, slots=True)
class CameraBump(Effect):
    """The mount is moved by motion (6) m, rad, in the camera's frame, from time (s from the recording's start) on."""

    place: str
    motion: tuple[float, ...] = (0.0,) * 6
    time: float = 0.0
    name: ClassVar = "camera_bump"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (
        Parameter("motion", "m, rad", (-0.1, 0.1), (1e-5, 1e-3), 6),
        Parameter("time", "s", (-np.inf, np.inf), (0, 1e5), role="moment"),
    )
    sudden: ClassVar = True
    experiment: ClassVar = "fixed cubes in view of that camera before and after"
    action: ClassVar = "Clamp the mount; poses from before and after that moment need a camera pose of their own."
    view: ClassVar = "time"
    fixed_mount: ClassVar = True

    def mount(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        return ((np.asarray(t) >= self.time) * float(self.at(Place("camera", camera.name))))[:, None] * np.asarray(
            self.motion, float
        )
