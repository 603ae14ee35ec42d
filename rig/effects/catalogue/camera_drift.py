"""Camera drift: one camera's mount creeps slowly to a new place."""

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
class CameraDrift(Effect):
    """The mount moves by motion (6) m, rad, in the camera's frame, times 1 - exp(-t / time_constant)."""

    place: str
    motion: tuple[float, ...] = (0.0,) * 6
    time_constant: float = 1800.0
    name: ClassVar = "camera_drift"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (
        Parameter("motion", "m, rad", (-0.1, 0.1), (1e-5, 1e-3), 6),
        Parameter("time_constant", "s", (1, 1e5), (60, 7200), role="log"),
    )
    sudden: ClassVar = True
    experiment: ClassVar = "fixed cubes in view of that camera for as long"
    action: ClassVar = "Let the mount warm up and clamp it better; keep fixed cubes in that camera's view."
    view: ClassVar = "time"
    fixed_mount: ClassVar = True

    def mount(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        share = (1 - np.exp(-np.maximum(t, 0) / self.time_constant)) * self.at(Place("camera", camera.name))
        return share[:, None] * np.asarray(self.motion, float)
