"""Kinds of mechanism: the union of types, and functions that require a kind or raise RigError."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.model.mechanism_geometry import Arm, Chain, Free, Hexapod, Planar2

if TYPE_CHECKING:
    from typing_extensions import TypeIs

Mechanism = Hexapod | Planar2 | Arm | Chain | Free
Struts = Hexapod | Planar2  # what moves a platform, or a hinge, on struts
Commanded = Hexapod | Planar2 | Arm | Chain  # what has axes


def has_struts(mechanism: Mechanism) -> TypeIs[Struts]:
    """Whether a mechanism stands on struts as a whole."""
    return mechanism.strut_joints is not None


def has_plates(mechanism: Mechanism) -> TypeIs[Hexapod]:
    """Whether a mechanism's struts stand between two plates, so that they hold all six coordinates of a pose."""
    return mechanism.plates is not None


def has_links(mechanism: Mechanism) -> TypeIs[Arm]:
    """Whether a mechanism is made of links, one joint after the other."""
    return mechanism.link_rows is not None


def has_stages(mechanism: Mechanism) -> TypeIs[Chain]:
    """Whether a mechanism is made of others, one upon the other."""
    return len(mechanism.stages) > 1


def has_axes(mechanism: Mechanism) -> TypeIs[Commanded]:
    """Whether a mechanism has axes to command."""
    return bool(mechanism.axes)


def require_hexapod(
    mechanism: Mechanism, refusal: str = "this takes a hexapod, not a mechanism of kind {kind!r}"
) -> Hexapod:
    """The mechanism, required to be a hexapod. Raises RigError for another kind."""
    if not has_plates(mechanism):
        raise RigError(refusal.format(kind=mechanism.kind))
    return mechanism


def require_struts(
    mechanism: Mechanism, refusal: str = "this takes a platform on struts, not a mechanism of kind {kind!r}"
) -> Struts:
    """The mechanism, required to have struts (hexapod or planar). Raises RigError for another kind.
    another kind.
    """
    if not has_struts(mechanism):
        raise RigError(refusal.format(kind=mechanism.kind))
    return mechanism


def require_arm(mechanism: Mechanism, refusal: str = "this takes an arm, not a mechanism of kind {kind!r}") -> Arm:
    """The mechanism, required to be an arm. Raises RigError for another kind."""
    if not has_links(mechanism):
        raise RigError(refusal.format(kind=mechanism.kind))
    return mechanism


def require_chain(mechanism: Mechanism) -> Chain:
    """The mechanism, required to be a chain of mechanisms. Raises RigError for another kind."""
    if not has_stages(mechanism):
        raise RigError(f"this takes a chain of mechanisms, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def target_bodies(mechanism: Mechanism) -> tuple[str, ...]:
    """Names of a mechanism's bodies that may carry targets: platform, base, and a chain's lower stages."""
    return ("platform", "base", *mechanism.bodies)


def require_axes(
    mechanism: Mechanism, refusal: str = "this takes a machine with axes, not a body that is moved by hand"
) -> Commanded:
    """The mechanism, required to have axes that are commanded. Raises RigError for a free body.
    is moved by hand.
    """
    if not has_axes(mechanism):
        raise RigError(refusal.format(kind=mechanism.kind))
    return mechanism
