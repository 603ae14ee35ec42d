"""Kinds of mechanism: the union of types, and functions that require a kind or raise RigError."""

from rig.errors import RigError
from rig.model.design import Arm, Chain, Free, Hexapod, Planar2

Mechanism = Hexapod | Planar2 | Arm | Chain | Free
Struts = Hexapod | Planar2  # what moves a platform, or a hinge, on struts


def require_hexapod(mechanism: Mechanism) -> Hexapod:
    """The mechanism, required to be a hexapod. Raises RigError for another kind."""
    if not isinstance(mechanism, Hexapod):
        raise RigError(f"this takes a hexapod, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def require_struts(mechanism: Mechanism) -> Struts:
    """The mechanism, required to have struts (hexapod or planar). Raises RigError for another kind."""
    if not isinstance(mechanism, Hexapod | Planar2):
        raise RigError(f"this takes a platform on struts, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def require_arm(mechanism: Mechanism) -> Arm:
    """The mechanism, required to be an arm. Raises RigError for another kind."""
    if not isinstance(mechanism, Arm):
        raise RigError(f"this takes an arm, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def require_chain(mechanism: Mechanism) -> Chain:
    """The mechanism, required to be a chain of mechanisms. Raises RigError for another kind."""
    if not isinstance(mechanism, Chain):
        raise RigError(f"this takes a chain of mechanisms, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def target_bodies(mechanism: Mechanism) -> tuple[str, ...]:
    """Names of a mechanism's bodies that may carry targets: platform, base, and a chain's lower stages."""
    return ("platform", "base", *(mechanism.bodies if isinstance(mechanism, Chain) else ()))


def require_axes(mechanism: Mechanism) -> Hexapod | Planar2 | Arm | Chain:
    """The mechanism, required to have axes that are commanded. Raises RigError for a free body."""
    if isinstance(mechanism, Free):
        raise RigError("this takes a machine with axes, not a body that is moved by hand")
    return mechanism
