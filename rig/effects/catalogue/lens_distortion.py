"""Lens distortion beyond the stated model.

Missing terms, or a smooth warp of the image.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    COUNT,
    Context,
    Drawing,
    Linear,
    Parameter,
    draw_log_uniform,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera, chebyshev_products, image_warp_columns

LACKING = {
    "thin prism": (8, 9, 10, 11),
    "radial": (5, 6, 7),
    "both": (5, 6, 7, 8, 9, 10, 11),
}  # terms that a lens may lack
SIZES = (0.05, 2.0)  # px RMS over the image, of what lenses lack
WARPS = (3, 5, 7)  # degrees of a smooth warp


@dataclass(frozen=True, slots=True)
class LensDistortion(Effect):
    """terms (12): what is added to OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 of the stated lens; warp (2 m) px: a
    smooth displacement fixed in the image, the coefficients in u, then in v, of the Chebyshev products of
    `products`."""

    place: str
    terms: tuple[float, ...] = (0.0,) * 12
    warp: tuple[float, ...] = ()
    name: ClassVar = "lens_distortion"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (
        Parameter("terms", "", (-10, 10), (1e-4, 0.5), 12),
        Parameter("warp", "px", (-1e3, 1e3), (2e-2, 2), 0),
    )
    experiment: ClassVar = "cover the whole image with corners: a lens is fixed in the frame, whatever the pose"
    action: ClassVar = "Calibrate that lens with more terms; what is fitted here already corrects this recording."
    view: ClassVar = "map"
    warps: ClassVar = True

    def problem(self) -> str | None:
        sizes = [0, *(image_warp_coefficient_count(degree) for degree in range(2, 31))]
        return (
            None
            if len(self.warp) in sizes
            else f"warp has {', '.join(map(str, sizes[:5]))} .. numbers, those of a degree, not {len(self.warp)}"
        )

    def camera(self, camera: Camera) -> Camera:
        if not self.at(Place("camera", camera.name)) or not any(self.terms):
            return camera
        terms = np.zeros(max(12, len(camera.distortion)))
        terms[: len(camera.distortion)] = camera.distortion
        terms[:12] += self.terms
        return replace(camera, distortion=terms)

    def print_(self, camera: Camera, quads: Floats) -> Floats:
        if not self.warp or not self.at(Place("camera", camera.name)):
            return quads
        return quads + chebyshev_products(camera, quads, _degree(len(self.warp))) @ np.reshape(self.warp, (2, -1)).T

    @classmethod
    def bending(cls, camera: Camera, quads: Floats, columns: Sequence[Linear]) -> Floats | None:
        if any(column.name != "warp" for column in columns):
            return None
        return image_warp_columns(camera, quads, _degree(len(columns)))

    def fitted(self, parameter: Parameter) -> tuple[int, ...]:
        if parameter.name == "terms" and self.warp:
            return ()  # a warp takes in whatever the lens' own terms could bend
        return tuple(i for i, value in enumerate(getattr(self, parameter.name)) if value)

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> "LensDistortion":
        size, which = draw_log_uniform(rng, *SIZES), rng.integers(3)
        free = range(image_warp_coefficient_count(WARPS[0])) if which == 2 else LACKING[("radial", "thin prism")[which]]
        unit = np.zeros(image_warp_coefficient_count(WARPS[0]) if which == 2 else 12)
        unit[list(free)] = rng.normal(size=len(free)) * 1e-3
        name, camera = "warp" if which == 2 else "terms", drawing.design.camera(Place.parse(place).name)
        moved = drawing.displaced(cls(place, **{name: tuple(unit.tolist())}), camera)
        return cls(place, **{name: tuple((unit * size / moved).tolist())})

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        have = len(context.design.camera(Place.parse(place).name).distortion)
        lacking = [
            Candidate(cls, place, [{}], [Linear("terms", j, 1e-4) for j in terms], label)
            for label, terms in LACKING.items()
            if min(terms) >= have
        ]
        return lacking + [
            Candidate(
                cls,
                place,
                [{COUNT: image_warp_coefficient_count(d)}],
                [Linear("warp", j, 1e-2) for j in range(image_warp_coefficient_count(d))],
                f"warp {d}",
            )
            for d in WARPS
        ]


def _degree(numbers: int) -> int:
    """The degree of a warp of so many numbers, see `count`."""
    return round((np.sqrt(25 + 4 * numbers) - 3) / 2)


def image_warp_coefficient_count(degree: int) -> int:
    """Number of coefficients of an image warp of a degree."""
    return (degree + 1) * (degree + 2) - 6
