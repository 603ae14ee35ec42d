"""Focal drift of a camera.

The focal length follows the temperature.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import REFERENCE_TEMPERATURE, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Parameter
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera

AMBIENT = "ambient_temperature_C"


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
    action: ClassVar = "Keep the cameras' temperature or let them warm up; log it so that it can be corrected."
    view: ClassVar = "scale"

    def focal(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        if not self.at(Place("camera", camera.name)):
            return np.ones(len(t))
        return 1 + self.per_kelvin * (channel(*_channels(camera.name)) - REFERENCE_TEMPERATURE)

    @classmethod
    def follows(cls, place: str, context: Context) -> tuple[tuple[str, ...], ...]:
        name = Place.parse(place).name
        return tuple(_channels(camera) for camera in ([name] if name else [c.name for c in context.design.cameras]))

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        found = super(FocalDrift, cls).sites(context)
        if not context.logged(AMBIENT):
            raise RigError(f"the model needs a sensor channel {AMBIENT!r}, which the recording does not have")
        return found


def _channels(camera: str) -> tuple[str, str]:
    """The channels, either of which tells a camera's temperature."""
    return f"camera_{camera}_temperature_C", AMBIENT
