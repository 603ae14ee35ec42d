"""Edge bias: marker edges seen displaced.

Exposure or print shifts every edge of the black square inward by so many pixels.
"""

from dataclasses import dataclass
from typing import ClassVar

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter
from rig.model.arm_hands_effect_places_and_tolerances import FINDER, Place
from rig.model.design import Camera, corners_of_squares_with_edges_moved_inward


@dataclass(frozen=True, slots=True)
class EdgeBias(Effect):
    """Every edge moves inward by bias px (positive: black shrinks); the corners are where the moved edges meet."""

    place: str
    bias: float = 0.0
    name: ClassVar = "edge_bias"
    stage: ClassVar = "view"
    places: ClassVar = ("camera", "cameras")
    parameters: ClassVar = (Parameter("bias", "px", (-3, 3), (0.05, 0.5), signed=True),)
    experiment: ClassVar = "vary the range: constant in pixels it is this, constant in millimetres it is the print"
    action: ClassVar = "Lower the exposure and refocus; the detector's threshold or the printer's ink moves every edge."
    view: ClassVar = "outward"
    tolerance: ClassVar = FINDER

    def print_(self, camera: Camera, quads: Floats) -> Floats:
        if self.bias == 0 or not self.at(Place("camera", camera.name)):
            return quads
        return corners_of_squares_with_edges_moved_inward(quads, self.bias)
