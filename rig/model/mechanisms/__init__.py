"""Kinds of machine, one module each, all with inverse, forward, jacobian and limits over a geometry of rig.model.design."""

from rig.model.mechanisms.kinematics_by_kind import ALL, kinematics_of, axis_places, travel_unit, axis_units
from rig.model.mechanisms.kinematics_interface import Kind

__all__ = ["ALL", "Kind", "kinematics_of", "axis_places", "travel_unit", "axis_units"]
