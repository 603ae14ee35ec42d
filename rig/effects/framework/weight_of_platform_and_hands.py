"""Weight of what a machine carries: its wrench, and the loads of the joints of an arm with several hands."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm as mechanism

UNSTATED = "needs mass and centre_of_mass of every [[mechanism.hand]] in rig.toml"


def weight_wrench(T: RigidTransform, gravity: Floats, mass: float | Floats, centre: Floats | None) -> Floats:
    """Wrench (n, 6) N and N m, in the axes of bodies at poses T (n,), of weights on their origins.

    gravity : (n, 3) m/s^2 in the frame of poses; mass : kg, of all or (n,) of each; centre : (3,) m, in the body
    Raises ValueError where no centre is stated
    """
    if centre is None:
        raise ValueError("where a weight acts is not stated")
    force = np.reshape(mass, (-1, 1)) * np.einsum("nji,nj->ni", T.rotation.as_matrix(), gravity)
    return np.concatenate([force, np.cross(centre, force)], axis=1)


def loads_by_weight_of_hands(q: Floats, arm: Arm, gravity: Floats) -> Floats:
    """Loads (n, joints) N m, of slides N, with which the joints at q (n, joints) hold all hands of an arm together.

    gravity : (n, 3) m/s^2 in the frame of poses. A joint that several hands stand on holds the weight of each.
    """
    out = np.zeros(q.shape)
    for number, hand in enumerate(arm.hands):
        seen = arm.of_hand(number)
        T = mechanism.forward(q, seen)
        out += mechanism.axis_loads(T, q, seen, weight_wrench(T, gravity, hand.mass or 0.0, hand.centre_of_mass))
    return out


def has_stated_weights(arm: Arm) -> bool:
    """Whether mass and centre of mass of every hand are stated."""
    return all(hand.mass is not None and hand.centre_of_mass is not None for hand in arm.hands)
