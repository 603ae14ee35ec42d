"""Kinds of machine, one module each, all with inverse, forward, jacobian and limits over a geometry of rig.model.design."""

from rig.model.mechanisms.kinematics_by_kind import ALL, of, places, unit, units
from rig.model.mechanisms.kinematics_interface import Kind

__all__ = ["ALL", "Kind", "of", "places", "unit", "units"]
