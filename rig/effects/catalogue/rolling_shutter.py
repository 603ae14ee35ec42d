"""Rolling shutter: rows of the image are exposed one after the other."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera


@dataclass(frozen=True, slots=True)
class RollingShutter(Effect):
    """Row v is exposed (v - height / 2) * row_time after the logged time."""

    place: str
    row_time: float = 0.0
    name: ClassVar = "rolling_shutter"
    stage: ClassVar = "view"
    places: ClassVar = ("camera", "cameras")
    parameters: ClassVar = (Parameter("row_time", "s", (-1e-3, 1e-3), (5e-6, 3e-5)),)
    experiment: ClassVar = "expose while moving, the platform high and low in the image"
    action: ClassVar = 'State shutter = "rolling" in rig.toml, with row_time if it is known, or expose at rest.'
    rolls: ClassVar = True

    def late(self, camera: Camera, v: Floats) -> Floats:
        return self.row_time * self.at(Place("camera", camera.name)) * (np.asarray(v) - camera.height / 2)
