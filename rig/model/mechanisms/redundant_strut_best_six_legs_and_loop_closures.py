"""Redundant struts: the best six legs give the pose, and the others' loop closures check it.

Six degrees of freedom are free; the lengths of seven or eight struts follow from them. Lengths that do not agree hold
the platform all the same, and strain the struts.

Legs are driven struts and measuring limbs alike. What a closure is expected to be follows from every leg's own error
and from how well its geometry is known; one leg that is off by the same all along shows in all closures that depend on
it, in proportions of its own.
Source: Merlet, Parallel Robots, 2nd ed., ch. 5 and 9 (redundant sensors); Hexapod forward kinematics for the chosen
    six.
"""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeVar

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged, RigError
from rig.model.design import MeasuringLimbs
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as kinematics
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, Mechanism, is_redundant

C = TypeVar("C", bound=Commanded)
SIX = 6  # legs that hold a platform
LOOKED_AT = 12  # poses, at most, over which sets of legs are compared
SINGULAR = 1e-6  # of the largest singular value: six legs that leave a platform loose
MAX_TRIALS = 60
INWARDS = 0.8  # by which lengths that leave the range are brought nearer to its middle at a time


def with_follower_struts_of(mechanism: C, recorded_mechanism: Mechanism | None) -> C:
    """The mechanism with the follower struts of the recorded mechanism.

    Without any where that is None.
    """
    if not is_redundant(mechanism):
        return mechanism
    return replace(
        mechanism,
        followers=recorded_mechanism.followers
        if recorded_mechanism is not None and is_redundant(recorded_mechanism)
        else (),
    )


def hexapod_of_actuated_struts(hexapod: Hexapod) -> Hexapod:
    """The hexapod of the actuated struts alone.

    Six that are driven, without its followers.
    """
    driven = actuated_strut_numbers(hexapod)
    return Hexapod(
        hexapod.base_joints[driven],
        hexapod.platform_joints[driven],
        hexapod.strut_range[driven],
        hexapod.home,
        hexapod.strut_zeros[driven],
    )


def actuated_strut_numbers(hexapod: Hexapod) -> Integers:
    """Numbers (k,), from 0, of the struts that are driven."""
    return np.setdiff1d(np.arange(len(hexapod.axes)), hexapod.followers)


def nearest_compatible_strut_lengths(lengths: Floats, hexapod: Hexapod, middle_range_share: float = 1.0) -> Floats:
    """Nearest lengths (n, struts) m to given ones that are compatible: they close on one pose.

    They are within the middle share `middle_range_share` of the strut range.
    Of six struts the lengths themselves. Of more, six degrees of freedom are free and the other lengths follow; those
    that would leave the range, or close on nothing, are brought nearer to its middle. Raises NotConverged where none do
    """
    if not is_redundant(hexapod):
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
        within = middle + (out[going] - middle) / middle_range_share
        going = going[kinematics.signed_limit_excess(within, hexapod).any(axis=1)]
        if not len(going):
            return out
        wanted[going] = middle + INWARDS * (wanted[going] - middle)
    raise NotConverged(
        "no lengths within the strut range close on one pose", going, wanted[going], np.full(len(going), np.inf)
    )


def incompatible_strut_length_component(T_base_platform: RigidTransform, lengths: Floats, hexapod: Hexapod) -> Floats:
    """Incompatible part (n, struts) m of commanded lengths, at the poses (n,) that they hold.

    It moves no platform.
    It is what struts press and pull against each other: times the stiffness of a strut, its internal force (N). The
    range of the Jacobian moves the platform, and the space perpendicular to it is of struts' forces that vanish in sum.
    Of six struts it is zero.
    Source: Merlet, Parallel Robots, 2nd ed., ch. 9; Pellegrino, Structural computations with the singular value
    decomposition of the equilibrium matrix, 1993 (states of self-stress)
    """
    J = kinematics.jacobian(T_base_platform, hexapod)
    off = lengths - kinematics.inverse(T_base_platform, hexapod)
    return np.asarray(off - np.einsum("nij,njk,nk->ni", J, np.linalg.pinv(J), off))


@dataclass(frozen=True, slots=True, eq=False)
class RedundantLegs:
    """k legs. names : (k,); base, platform : (k, 3) m, joints in the base and platform frames; zeros : (k,) m, what a
    leg is longer than it reads
    home : T_base_platform; sigma : (k,) m of a reading; covariance : (7 k, 7 k) m^2 of base joint, platform joint and
        zero, leg by leg"""

    names: tuple[str, ...]
    base: Floats
    platform: Floats
    zeros: Floats
    home: RigidTransform
    sigma: Floats
    covariance: Floats

    def six(self, chosen: Floats | Integers) -> Hexapod:
        """The Hexapod of six of the legs (6,)."""
        length = np.linalg.norm(self.home.apply(self.platform[chosen]) - self.base[chosen], axis=1)
        return Hexapod(
            self.base[chosen],
            self.platform[chosen],
            np.stack([0.2 * length, 3 * length], axis=1),
            self.home,
            self.zeros[chosen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class LegClosures:
    """n poses by six legs. T_base_platform : RigidTransform (n,); checks : (k - 6,) indices of the other legs
    error : (n, k - 6) m, what these read less what the pose says; covariance : (n, k - 6, k - 6) m^2 expected of it
    off : (k,) m, what each leg would have to be off by to explain the errors best, share : (k,) of their squares that
        this explains"""

    T_base_platform: RigidTransform
    checks: Integers
    error: Floats
    covariance: Floats
    off: Floats
    share: Floats


def combine_leg_sets(
    leg_sets: list[tuple[str, Hexapod | MeasuringLimbs, Floats, Floats]], home_pose: RigidTransform
) -> RedundantLegs:
    """Combine leg sets into RedundantLegs, about one home pose.

    Each set is (letter, geometry, sigma, covariance).
    home_pose : T_base_platform, about which they are looked for
    """
    blocks, names, zeros = [], list[str](), []
    for letter, m, sigma, covariance in leg_sets:
        n = len(sigma)
        order = np.array(
            [[*range(3 * i, 3 * i + 3), *range(3 * (n + i), 3 * (n + i) + 3), 6 * n + i] for i in range(n)]
        ).ravel()
        blocks.append(covariance[np.ix_(order, order)])
        names += [f"{letter}{i + 1}" for i in range(n)]
        zeros.append(m.strut_zeros if isinstance(m, Hexapod) else m.zeros)
    base, platform = (
        np.concatenate([getattr(m, name) for _, m, *_ in leg_sets]) for name in ("base_joints", "platform_joints")
    )
    return RedundantLegs(
        tuple(names),
        base,
        platform,
        np.concatenate(zeros),
        home_pose,
        np.concatenate([sigma for *_, sigma, _ in leg_sets]),
        scipy.linalg.block_diag(*blocks),
    )


def leg_lengths_and_pose_and_base_jacobians(legs: RedundantLegs, T: RigidTransform) -> tuple[Floats, Floats, Floats]:
    """Leg lengths (n, k) m, and their Jacobians by pose and base joints.

    Jacobians (n, k, 6) with the pose, and (n, k, 3) with the base joints.
    """
    matrix = T.as_matrix()
    R, place = matrix[:, :3, :3], matrix[:, :3, 3]
    along = np.einsum("nij,kj->nki", R, legs.platform) + place[:, None] - legs.base
    length = np.linalg.norm(along, axis=2)
    unit = along / length[..., None]
    own = np.einsum("nki,nij->nkj", unit, R)
    return length - legs.zeros, np.concatenate([own, np.cross(legs.platform, own)], axis=2), -unit


def leg_parameter_jacobians(legs: RedundantLegs, T: RigidTransform) -> Floats:
    """Jacobians (n, k, 7 k) of leg lengths by the legs' parameters.

    Base joint, platform joint, zero.
    """
    own = _slope(leg_lengths_and_pose_and_base_jacobians(legs, T)[2], T)
    return (np.eye(own.shape[1])[:, :, None] * own[:, :, None]).reshape(*own.shape[:2], -1)


def _slope(to_base: Floats, T: RigidTransform) -> Floats:
    """(n, k, 7) of what each leg reads with its own base joint, platform joint and zero. to_base : (n, k, 3), of the
    first
    """
    return np.concatenate(
        [to_base, -np.einsum("nki,nij->nkj", to_base, T.as_matrix()[:, :3, :3]), -np.ones((*to_base.shape[:2], 1))],
        axis=2,
    )


def best_six_leg_indices(legs: RedundantLegs, T: RigidTransform) -> Integers:
    """Indices (6,) of the best six legs for poses T (n,).

    They determine the poses best in the worst direction and pose.
    Raises RigError where none of them holds the platform
    """
    size = float(np.linalg.norm(legs.platform - legs.platform.mean(axis=0), axis=1).mean())
    J = leg_lengths_and_pose_and_base_jacobians(
        legs, T[np.unique(np.linspace(0, len(T) - 1, min(len(T), LOOKED_AT)).round().astype(int))]
    )[1]
    J = J / np.repeat([1.0, size], 3) / legs.sigma[:, None]
    sets = np.array(list(combinations(range(len(legs.names)), SIX)))
    values = np.linalg.svd(J[:, sets], compute_uv=False)  # (poses, sets, 6)
    least = values[..., -1].min(axis=0)
    if (values[..., -1] / values[..., 0]).min(axis=0).max() < SINGULAR:
        raise RigError(f"no six of the {len(legs.names)} legs hold the platform")
    return sets[int(least.argmax())]


def leg_closures(legs: RedundantLegs, lengths: Floats, chosen_six: Integers) -> LegClosures:
    """Closure errors (LegClosures) of legs with lengths (n, k) m.

    Errors of the other legs at poses from the six chosen ones.
    Raises RigError where the six leave the platform loose at a pose
    """
    checks = np.setdiff1d(np.arange(len(legs.names)), chosen_six)
    T = kinematics.forward(lengths[:, chosen_six], legs.six(chosen_six))
    predicted, J, to_base = leg_lengths_and_pose_and_base_jacobians(legs, T)
    values = np.linalg.svd(J[:, chosen_six], compute_uv=False)
    if (values[:, -1] < SINGULAR * values[:, 0]).any():
        raise RigError(
            f"{', '.join(legs.names[i] for i in chosen_six)} leave the platform loose at pose "
            f"{int((values[:, -1] / values[:, 0]).argmin())}"
        )
    back = np.linalg.solve(np.swapaxes(J[:, chosen_six], 1, 2), np.swapaxes(J[:, checks], 1, 2))
    by = np.zeros((len(lengths), len(checks), len(legs.names)))  # closure per leg's reading
    by[:, np.arange(len(checks)), checks] = 1.0
    by[:, :, chosen_six] = -np.swapaxes(back, 1, 2)
    slope = _slope(to_base, T)
    G = by[:, :, :, None] * slope[:, None]  # with base joint, platform joint and zero of every leg
    G = G.reshape(len(lengths), len(checks), -1)
    covariance = (by * legs.sigma**2) @ np.swapaxes(by, 1, 2) + G @ legs.covariance @ np.swapaxes(G, 1, 2)
    error = lengths[:, checks] - predicted[:, checks]
    return LegClosures(T, checks, error, covariance, *_off(by, error, covariance))


def _off(by: Floats, error: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """(off (k,) m, share (k,)): each leg's offset that explains the errors best alone, and the share of their squares
    that goes with it.
    """
    weighed = np.linalg.solve(covariance, by)
    right, gram = np.einsum("nci,nc->i", weighed, error), np.einsum("nci,nci->i", weighed, by)
    whole = np.einsum("nc,nc->", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    off = right / np.maximum(gram, 1e-300)
    return off, right * off / max(whole, 1e-300)
