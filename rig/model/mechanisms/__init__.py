"""Kinds of machine, one module each, all with inverse, forward, jacobian and signed_limit_excess over a
geometry of rig.model.mechanism_geometry_classes.
"""

from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    ALL,
    MechanismKinematics,
    axis_place_texts,
    axis_places,
    axis_units,
    kinematics_of,
    travel_unit,
    with_followers,
)
from rig.model.user_kinematics_file import Axis, Parameter

__all__ = [
    "Axis",
    "Parameter",
    "ALL",
    "MechanismKinematics",
    "kinematics_of",
    "axis_place_texts",
    "axis_places",
    "travel_unit",
    "axis_units",
    "with_followers",
]
