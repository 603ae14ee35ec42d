"""Kinds of machine, one module each, all with inverse, forward, jacobian and limits over a geometry of
rig.model.design.
"""

from rig.model.mechanisms.kinematics_by_kind import ALL, axis_places, axis_units, kinematics_of, travel_unit
from rig.model.mechanisms.kinematics_interface import Kind

__all__ = ["ALL", "Kind", "kinematics_of", "axis_places", "travel_unit", "axis_units"]
