"""A plane-parallel window stands before a camera."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter

INDEX = 1.5  # of the window's glass against air


@dataclass(frozen=True, slots=True)
class Refraction(Effect):
    """A window of a thickness (m), square to the optical axis: what lies behind it seems nearer, the more the more obliquely."""

    place: str
    thickness: float = 0.0
    name: ClassVar = "refraction"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (Parameter("thickness", "m", (0, 0.2), (1e-3, 3e-2)),)
    experiment: ClassVar = "a sweep in depth: no lens depends on the range"

    def bend(self, camera, points):
        if self.thickness <= 0 or not self.at(f"camera {camera.name}"):
            return points
        z, r = points[..., 2], np.linalg.norm(points[..., :2], axis=-1)
        slope = r / z  # tangent of the ray's angle outside the glass
        for _ in range(50):  # the ray's lateral shift in the glass, Snell's law
            sine = slope / np.sqrt(1 + slope**2)
            inside = sine / np.sqrt(INDEX**2 - sine**2)
            new = (r - self.thickness * inside) / (z - self.thickness)
            if np.abs(new - slope).max(initial=0) < 1e-15:
                break
            slope = new
        return np.concatenate([points[..., :2] * (slope * z / np.where(r > 0, r, 1))[..., None], points[..., 2:]], axis=-1)
