"""Kinds of machine, one module each, all with inverse, forward, jacobian and limits over a geometry of rig.design."""

from rig.errors import RigError
from rig.mechanisms import arm, hexapod, planar

ALL = {"hexapod": hexapod, "planar2": planar, "arm": arm}


def of(mechanism):
    """The module that moves a mechanism (Hexapod, Planar2, Arm). Raises RigError for a kind that has no kinematics here."""
    if mechanism.kind not in ALL:
        raise RigError(f"no kinematics for a mechanism of kind {mechanism.kind!r}; there are {', '.join(ALL)}")
    return ALL[mechanism.kind]
