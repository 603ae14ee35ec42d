"""Cube misplacement: one cube sits off its stated pose."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Markers,
    Parameter,
    markers_with_replaced_columns,
)
from rig.model.arm_hands_effect_places_and_tolerances import SEAT, Place
from rig.model.pose import displace_selected_poses, exp


@dataclass(frozen=True, slots=True)
class CubeMisplacement(Effect):
    """All markers of a target moved together: motion (6) m and rad about the target's middle, along its body's axes."""

    place: str
    motion: tuple[float, ...] = (0.0,) * 6
    name: ClassVar = "cube_misplacement"
    stage: ClassVar = "targets"
    places: ClassVar = ("target",)
    parameters: ClassVar = (Parameter("motion", "m, rad", (-1, 1), (5e-5, 1e-3), 6),)
    experiment: ClassVar = "see that cube together with others of its body"
    action: ClassVar = "Reseat that cube, or measure it and state its true pose."
    view: ClassVar = "targets"
    tolerance: ClassVar = SEAT

    def attach(self, markers: Markers) -> Markers:
        rows = np.array([self.at(Place("target", name)) for name in markers.target])
        if not rows.any():
            return markers
        middle = markers.T_body_marker.translation[rows].mean(axis=0)
        shift = exp(np.r_[middle, 0, 0, 0]) * exp(np.asarray(self.motion)) * exp(np.r_[-middle, 0, 0, 0])
        return markers_with_replaced_columns(
            markers, T_body_marker=displace_selected_poses(markers.T_body_marker, rows, lambda T: shift * T)
        )
