"""The kinematics of a mechanism by its kind, and the names and units of its axes."""

from functools import cache
from typing import Any

from rig.errors import RigError
from rig.model.design import Arm, Chain, Free, Hexapod, Planar2
from rig.model.mechanisms import arm, chain, hexapod, two_strut_plane
from rig.model.mechanisms.kinematics_interface import Kind

ALL: dict[str, Kind[Any]] = {"hexapod": hexapod, "planar2": two_strut_plane, "arm": arm, "chain": chain}


def kinematics_of(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> Kind[Any]:
    """The module that moves a mechanism (Hexapod, Planar2, Arm, Chain). Raises RigError for a kind that has no
    kinematics here.
    """
    if mechanism.kind not in ALL:
        raise RigError(f"no kinematics for a mechanism of kind {mechanism.kind!r}; there are {', '.join(ALL)}")
    return ALL[mechanism.kind]


def axis_places(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> tuple[str, ...]:
    """The places of a mechanism's axes: "strut 1" .. or "joint 1" .., an arm's prismatic joint "slide 3", a chain's
    "stage 2 strut 1"; none for what nobody commands."""
    if not mechanism.axes:
        return ()
    if isinstance(mechanism, Chain):
        return tuple(
            f"stage {k + 1} {place}" for k, stage in enumerate(mechanism.stages) for place in axis_places(stage)
        )
    return _numbered(
        tuple("slide" if slide else arm.AXIS for slide in mechanism.slides)
        if isinstance(mechanism, Arm)
        else (kinematics_of(mechanism).AXIS,) * len(mechanism.axes)
    )


@cache
def _numbered(words: tuple[str, ...]) -> tuple[str, ...]:
    """The places of axes that are called so, counted from 1."""
    return tuple(f"{word} {i + 1}" for i, word in enumerate(words))


def travel_unit(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> str:
    """Unit of the axes' travel, "m" or "rad", of an arm that has both "rad or m"."""
    return " or ".join(dict.fromkeys(sorted(axis_units(mechanism), reverse=True)))


def axis_units(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> tuple[str, ...]:
    """Unit of each axis' travel, "m" or "rad"; none for what nobody commands."""
    if not mechanism.axes:
        return ()
    if isinstance(mechanism, Chain):
        return tuple(one for stage in mechanism.stages for one in axis_units(stage))
    return (
        tuple("m" if slide else arm.UNIT for slide in mechanism.slides)
        if isinstance(mechanism, Arm)
        else (kinematics_of(mechanism).UNIT,) * len(mechanism.axes)
    )
