"""What kind of mechanism a machine has: told by its type, or refused."""

from rig.errors import RigError
from rig.model.design import Arm, Chain, Free, Hexapod, Planar2

Mechanism = Hexapod | Planar2 | Arm | Chain | Free
Struts = Hexapod | Planar2  # what moves a platform, or a hinge, on struts


def hexapod_of(mechanism: Mechanism) -> Hexapod:
    """The mechanism, which is a hexapod. Raises RigError for another kind."""
    if not isinstance(mechanism, Hexapod):
        raise RigError(f"this takes a hexapod, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def struts_of(mechanism: Mechanism) -> Struts:
    """The mechanism, which moves a platform on struts. Raises RigError for another kind."""
    if not isinstance(mechanism, Hexapod | Planar2):
        raise RigError(f"this takes a platform on struts, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def arm_of(mechanism: Mechanism) -> Arm:
    """The mechanism, which is an arm. Raises RigError for another kind."""
    if not isinstance(mechanism, Arm):
        raise RigError(f"this takes an arm, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def chain_of(mechanism: Mechanism) -> Chain:
    """The mechanism, which is a chain of others. Raises RigError for another kind."""
    if not isinstance(mechanism, Chain):
        raise RigError(f"this takes a chain of mechanisms, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def bodies_of(mechanism: Mechanism) -> tuple[str, ...]:
    """The bodies of a rig that may carry targets: "platform", "base", and of a chain what its stages move below the
    platform, "stage 1" ..
    """
    return ("platform", "base", *(mechanism.bodies if isinstance(mechanism, Chain) else ()))


def axes_of(mechanism: Mechanism) -> Hexapod | Planar2 | Arm | Chain:
    """The mechanism, which has axes to command. Raises RigError for a body that is moved by hand."""
    if isinstance(mechanism, Free):
        raise RigError("this takes a machine with axes, not a body that is moved by hand")
    return mechanism
