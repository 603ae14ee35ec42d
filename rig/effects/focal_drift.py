"""The focal length follows the temperature."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import REFERENCE_TEMPERATURE, Effect, Parameter


@dataclass(frozen=True, slots=True)
class FocalDrift(Effect):
    """f (1 + per_kelvin (T - 20 C)), T the camera's own channel where it has one, else the room's."""

    place: str
    per_kelvin: float = 0.0
    name: ClassVar = "focal_drift"
    stage: ClassVar = "view"
    places: ClassVar = ("cameras", "camera")
    parameters: ClassVar = (Parameter("per_kelvin", "1/K", (-1e-2, 1e-2), (1e-5, 4e-4), signed=True),)
    experiment: ClassVar = "watch fixed cubes while the temperature changes"

    def focal(self, camera, t, channel):
        if not self.at(f"camera {camera.name}"):
            return np.ones(len(t))
        warmth = channel(f"camera_{camera.name}_temperature_C", "ambient_temperature_C")
        return 1 + self.per_kelvin * (warmth - REFERENCE_TEMPERATURE)
