"""Marker flatness: a marker is not plane.

One corner stands off its plane, since the paper is lifted or bent.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Drawing,
    Markers,
    Parameter,
    draw_scalar_parameter,
    markers_with_replaced_columns,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place

CORNERS = 4


@dataclass(frozen=True, slots=True)
class MarkerFlatness(Effect):
    """The marker's corner number `corner` (0 the print's top left, then clockwise) stands off its plane by height,
    outward, since the face is behind it; the other three stay. A quarter of that is the saddle + - + -, which no motion
    of the whole marker makes; the rest is one. By solid geometry."""

    place: str
    height: float = 0.0
    corner: float = 0.0
    name: ClassVar = "marker_flatness"
    stage: ClassVar = "targets"
    places: ClassVar = ("marker",)
    parameters: ClassVar = (
        Parameter("height", "m", (0, 1e-2), (1e-4, 2e-3)),
        Parameter("corner", "", (0, CORNERS - 1), (0, CORNERS - 1), role="choice", tried=(0.0, 1.0, 2.0, 3.0)),
    )
    experiment: ClassVar = "see that face obliquely from several sides: a lifted corner is no motion of the whole face"
    action: ClassVar = "Glue that corner down or print the marker on a stiff plate, else omit it from rig.toml."
    view: ClassVar = "markers"
    flat: ClassVar = False

    def problem(self) -> str | None:
        return None if self.corner == int(self.corner) else "corner is a whole number"

    def attach(self, markers: Markers) -> Markers:
        rows = np.array([self.at(Place("marker", str(number))) for number in markers.id])
        lifted = rows[:, None] & (np.arange(CORNERS) == int(self.corner))
        return markers_with_replaced_columns(markers, heights=markers.heights + self.height * lifted)

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        return cls(place, draw_scalar_parameter(cls.parameters[0], drawing, rng), float(rng.integers(CORNERS)))
