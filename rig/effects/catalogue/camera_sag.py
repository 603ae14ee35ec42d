"""Camera sag: a camera's mount yields to its own weight.

As gravity turns in the base's frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Linear, Parameter
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.base_and_link_tilt_sensors import GRAVITY, has_gravity_sensor_channels, logged_gravity
from rig.model.design import Camera

WEIGHT = 9.80665  # m/s^2, for which `yields` is stated
TURNS = 0.02  # of it, RMS, from which a component of gravity is asked for


@dataclass(frozen=True, slots=True)
class CameraSag(Effect):
    """The mount moves by yields (18) m, rad, in the camera's frame: six numbers per g along each axis of the base."""

    place: str
    yields: tuple[float, ...] = (0.0,) * 18
    name: ClassVar = "camera_sag"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (Parameter("yields", "m, rad", (-0.1, 0.1), (1e-5, 1e-3), 18),)
    experiment: ClassVar = "fixed cubes in view of that camera while the base tilts"
    action: ClassVar = "Stiffen the mount, or support the camera at its centre of mass; keep fixed cubes in its view."
    view: ClassVar = "time"
    fixed_mount: ClassVar = True

    def mount(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        if not any(self.yields) or not self.at(Place("camera", camera.name)):
            return np.zeros((len(t), 6))
        return logged_gravity(channel) / WEIGHT @ np.asarray(self.yields, float).reshape(3, 6)

    def fitted(self, parameter: Parameter) -> tuple[int | None, ...]:
        return tuple(6 * axis + i for axis in range(3) for i in range(6) if any(self.yields[6 * axis : 6 * axis + 6]))

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        if not _turning(context):
            raise RigError(
                "the model needs gravity that turns in the base frame: state [[environment.tilt]] in rig.toml, or log "
                + ", ".join(GRAVITY)
            )
        return super(CameraSag, cls).sites(context)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        columns = [Linear("yields", 6 * axis + i, 1e-4) for axis in _turning(context) for i in range(6)]
        return [Candidate(cls, place, [{}], columns)]


def _turning(context: Context) -> tuple[int, ...]:
    """The axes of the base along which gravity changes in a recording."""
    sensors = context.sensors
    if sensors is None or not has_gravity_sensor_channels(sensors.channels):
        return ()
    down = logged_gravity(lambda name: sensors.at(context.t, name)) / WEIGHT
    return tuple(np.flatnonzero(down.std(axis=0) > TURNS).tolist())
