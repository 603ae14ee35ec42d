"""Refraction before a camera.

By a plane-parallel window.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, Self

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    Drawing,
    Parameter,
    draw_scalar_parameter,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera

INDEX = 1.5  # of the window's glass against air
SQUARE, MOST = 0.5, np.radians(45)  # of drawn windows: share that is not tilted, greatest tilt of the others
STEEPEST = np.radians(60)  # to which a window may be tilted
TILTS, TOWARDS = (
    np.radians([30.0]),
    np.arange(8) * np.pi / 4,
)  # of windows that are looked for besides a square one; a fit does the rest


@dataclass(frozen=True, slots=True)
class Refraction(Effect):
    """A window of a thickness (m) whose normal (3, camera frame, of any length) leads away from the camera: what lies
    behind it seems nearer along it, the more the more obliquely. How far away the window stands makes no difference."""

    place: str
    thickness: float = 0.0
    normal: tuple[float, ...] = (0.0, 0.0, 1.0)
    name: ClassVar = "refraction"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (
        Parameter("thickness", "m", (0, 0.2), (1e-3, 3e-2)),
        Parameter("normal", "", (-10, 10), (0.1, 1), 3, role="direction"),
    )
    experiment: ClassVar = "a sweep in depth: no lens depends on the range"
    action: ClassVar = "Take the window away, or set it square to the camera and state it."
    view: ClassVar = "map"

    def problem(self) -> str | None:
        if np.linalg.norm(self.normal) > 0 and self.normal[2] >= np.cos(STEEPEST) * np.linalg.norm(self.normal):
            return None
        return (
            f"a window's normal leads away from the camera, tilted by at most {np.degrees(STEEPEST):.0f} degrees, "
            f"not along {list(self.normal)}"
        )

    def bend(self, camera: Camera, points: Floats) -> Floats:
        if self.thickness <= 0 or not self.at(Place("camera", camera.name)):
            return points
        normal = np.asarray(self.normal, float) / np.linalg.norm(self.normal)
        z = points @ normal
        across = points - z[..., None] * normal
        r = np.linalg.norm(across, axis=-1)
        slope = r / z  # tangent of the ray's angle outside the glass
        for _ in range(50):  # the ray's lateral shift in the glass, Snell's law
            sine = slope / np.sqrt(1 + slope**2)
            inside = sine / np.sqrt(INDEX**2 - sine**2)
            new = (r - self.thickness * inside) / (z - self.thickness)
            if np.abs(new - slope).max(initial=0) < 1e-15:
                break
            slope = new
        return across * (slope * z / np.where(r > 0, r, 1))[..., None] + z[..., None] * normal

    def conserved_sums(self) -> tuple[dict[tuple[str, int | None], float], ...]:
        return ({("normal", i): value for i, value in enumerate(self.normal)},)

    def fitted(self, parameter: Parameter) -> tuple[int | None, ...]:
        if parameter.name == "normal" and tuple(self.normal) == (0.0, 0.0, 1.0):
            return ()  # found square to the camera; tilted ones were looked for as well
        return super(Refraction, self).fitted(parameter)

    def written(self) -> Self:
        return replace(self, normal=tuple((np.asarray(self.normal) / np.linalg.norm(self.normal)).tolist()))

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        thickness = draw_scalar_parameter(cls.parameters[0], drawing, rng)
        if rng.random() < SQUARE:
            return cls(place, thickness)
        tilt, toward = rng.uniform(0, MOST), rng.uniform(0, 2 * np.pi)
        return cls(
            place,
            thickness,
            (float(np.sin(tilt) * np.cos(toward)), float(np.sin(tilt) * np.sin(toward)), float(np.cos(tilt))),
        )

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        tilted = [
            {"normal": (float(np.sin(a) * np.cos(b)), float(np.sin(a) * np.sin(b)), float(np.cos(a)))}
            for a, b in product(TILTS, TOWARDS)
        ]
        linear = cls.linear(place)
        return [Candidate(cls, place, [{}], linear), Candidate(cls, place, tilted, linear, "tilted", extra=2)]
