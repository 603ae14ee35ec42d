"""More struts than six: lengths that close on one pose, what others press against each other, and followers.

Six degrees of freedom are free; the lengths of seven or eight struts follow from them. Lengths that do not agree hold
the platform all the same, and strain the struts.
"""

from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as kinematics
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, Mechanism, is_redundant

C = TypeVar("C", bound=Commanded)
MAX_TRIALS = 60
INWARDS = 0.8  # by which lengths that leave the range are brought nearer to its middle at a time


def with_followers_of(mechanism: C, recorded: Mechanism | None) -> C:
    """The mechanism with the followers of another, of the same struts, as it was recorded; none for None."""
    if not is_redundant(mechanism):
        return mechanism
    return replace(mechanism, followers=recorded.followers if recorded is not None and is_redundant(recorded) else ())


def driven_six(hexapod: Hexapod) -> Hexapod:
    """The hexapod of the six struts that are driven, without its followers."""
    driven = driven_struts(hexapod)
    return Hexapod(
        hexapod.base_joints[driven],
        hexapod.platform_joints[driven],
        hexapod.strut_range[driven],
        hexapod.home,
        hexapod.strut_zeros[driven],
    )


def driven_struts(hexapod: Hexapod) -> Integers:
    """Numbers (k,), from 0, of the struts that are driven."""
    return np.setdiff1d(np.arange(len(hexapod.axes)), hexapod.followers)


def agreeing_lengths(lengths: Floats, hexapod: Hexapod, share: float = 1.0) -> Floats:
    """Lengths (n, struts) m near given ones that close on one pose, within the middle `share` of the strut range.

    Of six struts the lengths themselves. Of more, six degrees of freedom are free and the other lengths follow; those
    that would leave the range, or close on nothing, are brought nearer to its middle. Raises NotConverged where none do
    """
    if len(hexapod.axes) == 6:
        return lengths
    middle, out = hexapod.strut_range.mean(axis=1), np.empty(np.shape(lengths))
    wanted, going = np.array(lengths, float), np.arange(len(lengths))
    for _ in range(MAX_TRIALS):
        try:
            out[going] = kinematics.inverse(kinematics.forward(wanted[going], hexapod), hexapod)
        except NotConverged as error:
            some = going[error.index]
            wanted[some] = middle + INWARDS * (wanted[some] - middle)
            continue
        within = middle + (out[going] - middle) / share
        going = going[kinematics.signed_limit_excess(within, hexapod).any(axis=1)]
        if not len(going):
            return out
        wanted[going] = middle + INWARDS * (wanted[going] - middle)
    raise NotConverged(
        "no lengths within the strut range close on one pose", going, wanted[going], np.full(len(going), np.inf)
    )


def conflict(T_base_platform: RigidTransform, lengths: Floats, hexapod: Hexapod) -> Floats:
    """Part (n, struts) m of commanded lengths, at the poses (n,) that they hold, that moves no platform.

    It is what struts press and pull against each other: times the stiffness of a strut, its internal force (N). The
    range of the Jacobian moves the platform, and the space perpendicular to it is of struts' forces that vanish in sum.
    Of six struts it is zero.
    Source: Merlet, Parallel Robots, 2nd ed., ch. 9; Pellegrino, Structural computations with the singular value
    decomposition of the equilibrium matrix, 1993 (states of self-stress)
    """
    J = kinematics.jacobian(T_base_platform, hexapod)
    off = lengths - kinematics.inverse(T_base_platform, hexapod)
    return np.asarray(off - np.einsum("nij,njk,nk->ni", J, np.linalg.pinv(J), off))
