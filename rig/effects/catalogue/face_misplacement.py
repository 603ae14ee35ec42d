"""Face misplacement: one face's marker sits off its stated place on its cube."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Markers,
    Parameter,
    markers_with_replaced_columns,
)
from rig.model.arm_hands_effect_places_and_tolerances import PLACES, Place
from rig.model.pose import displace_selected_poses, exp


@dataclass(frozen=True, slots=True)
class FaceMisplacement(Effect):
    """The marker's pose times a motion: offset (3) m and rotation (3) rad in its own frame, x right, y up, z out."""

    place: str
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0)
    name: ClassVar = "face_misplacement"
    stage: ClassVar = "targets"
    places: ClassVar = ("marker",)
    parameters: ClassVar = (
        Parameter("offset", "m", (-0.1, 0.1), (5e-5, 1e-3), 3),
        Parameter("rotation", "rad", (-3.2, 3.2), (1e-3, 2e-2), 3),
    )
    experiment: ClassVar = "see that face from several cameras and poses"
    action: ClassVar = "Reglue that face or omit its marker from rig.toml."
    view: ClassVar = "markers"
    tolerance: ClassVar = PLACES

    def attach(self, markers: Markers) -> Markers:
        rows = np.array([self.at(Place("marker", str(number))) for number in markers.id])
        return markers_with_replaced_columns(
            markers,
            T_body_marker=displace_selected_poses(
                markers.T_body_marker, rows, lambda T: T * exp(np.r_[self.offset, self.rotation])
            ),
        )
