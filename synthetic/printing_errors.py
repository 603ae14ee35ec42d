"""How printed markers really are: each a little out of its place on its face and of its stated side."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.effects.framework.effect import Effect
from rig.model.design import Design
from rig.model.pose import exp
from vision.targets import MarkerMap, marker_map


@dataclass(frozen=True, slots=True)
class Printing(Effect):
    """offsets (2 m) : m, each marker's shift in its plane, x right and y up, in the map's order
    scales (m) : its printed side over the stated, less 1"""

    place: str
    offsets: tuple[float, ...]
    scales: tuple[float, ...]
    name: ClassVar = "printing"
    stage: ClassVar = "targets"
    places: ClassVar = ("markers",)

    def attach(self, markers: MarkerMap) -> MarkerMap:
        tangent = np.zeros((len(markers.id), 6))
        tangent[:, :2] = np.reshape(self.offsets, (-1, 2))
        return replace(
            markers,
            T_body_marker=markers.T_body_marker * exp(tangent),
            side=markers.side * (1 + np.asarray(self.scales)),
        )


def draw_printing_errors(design: Design, rng: np.random.Generator, place: float, side: float) -> Printing:
    """Printing of a design's markers. place : m, standard deviation of each shift; side : of the share by which all
    sides are off, and each besides."""
    count = len(marker_map(design).id)
    scales = side * (rng.normal() + rng.normal(size=count))
    return Printing("markers", tuple((place * rng.normal(size=2 * count)).tolist()), tuple(scales.tolist()))
