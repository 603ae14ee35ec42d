"""A lens has terms that its stated model lacks."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class LensDistortion(Effect):
    """terms (12): what is added to OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 of the stated lens."""

    place: str
    terms: tuple[float, ...] = (0.0,) * 12
    name: ClassVar = "lens_distortion"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (Parameter("terms", "", (-10, 10), (1e-4, 0.5), 12),)
    experiment: ClassVar = "cover the whole image with corners: a lens is fixed in the frame, whatever the pose"

    def camera(self, camera):
        if not self.at(f"camera {camera.name}"):
            return camera
        terms = np.zeros(max(12, len(camera.distortion)))
        terms[: len(camera.distortion)] = camera.distortion
        terms[:12] += self.terms
        return replace(camera, distortion=terms)
