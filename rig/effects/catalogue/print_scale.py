"""Print scale: the markers were printed too large or too small."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Markers,
    Parameter,
    markers_with_replaced_columns,
)
from rig.model.arm_hands_effect_places_and_tolerances import SIDES


@dataclass(frozen=True, slots=True)
class PrintScale(Effect):
    """Printed side = stated side * (1 + scale), every marker about its own middle."""

    place: str
    scale: float = 0.0
    name: ClassVar = "print_scale"
    stage: ClassVar = "targets"
    places: ClassVar = ("markers",)
    parameters: ClassVar = (Parameter("scale", "", (-0.1, 0.1), (1e-4, 5e-3), signed=True),)
    experiment: ClassVar = (
        "measure a printed sheet, or vary the range: an edge bias is constant in pixels, this in millimetres"
    )
    action: ClassVar = "Measure a printed sheet with a caliper and state the true side of the markers."
    view: ClassVar = "outward"
    tolerance: ClassVar = SIDES

    def attach(self, markers: Markers) -> Markers:
        return markers_with_replaced_columns(markers, side=markers.side * (1 + self.scale))
