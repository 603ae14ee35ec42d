"""Wrench that a posture can exert within joint torque limits: margins, force polytope, weakest direction.

Torques within their limits, less what the arm's own weight takes, are a box; forces that map into it by J^T are a
polytope, so that the greatest force along a direction is where the ray leaves it, the least greatest force the radius
of the ball inside it, and the greatest of all a corner. Source: patent on force measurement and generation with
redundant manipulators, [0005], [0014]; Chiacchio, Bouffard-Vercelli and Pierrot, Force polytope and force ellipsoid for
redundant manipulators, 1997.
"""

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from rig.arrays import Floats
from rig.errors import RigError
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms.arm_dynamics import Links

FELT = 1e-9  # of the largest entry; a joint that a direction loads less than that does not limit it
INSIDE = 1e-9  # of a limit, by which a corner may lie outside and still be one
DIFFERENCE = 1e-6  # rad or m, of the slope


@dataclass(frozen=True, slots=True, eq=False)
class Strength:
    """What bounds an arm of n joints. limits : (n,) N m, of slides N; links : Links, or None for an arm whose weight is
    not stated
    gravity : (3,) m/s^2 in the axes of poses"""

    limits: Floats
    links: Links | None
    gravity: Floats

    def weight(self, q: Floats, arm: Arm) -> Floats:
        """(..., n) N m that hold the arm itself at joint values q (..., n) rad."""
        q = np.asarray(q, float)
        if self.links is None:
            return np.zeros(q.shape)
        flat = q.reshape(-1, q.shape[-1])
        each = np.column_stack([self.links.mass, self.links.mass[:, None] * self.links.centre]).ravel()  # kg and kg m
        return (mechanism.links(mechanism.forward(flat, arm), flat, arm, self.gravity) @ each).reshape(q.shape)

    def box(self, q: Floats, arm: Arm) -> tuple[Floats, Floats]:
        """(low, high (..., n) N m) between which torques for a wrench may lie at joint values q (..., n) rad."""
        weight = self.weight(q, arm)
        return -self.limits - weight, self.limits - weight


@dataclass(frozen=True, slots=True, eq=False)
class Exertion:
    """A posture is chosen for the greatest multiple of a wrench (6,) N, Nm that it can exert, at the hand's origin, in
    the axes of poses.

    strength : Strength. Raises ValueError for a wrench of nothing
    """

    wrench: Floats
    strength: Strength

    def __post_init__(self) -> None:
        if np.shape(self.wrench) != (6,) or not np.any(self.wrench):
            raise ValueError(f"expected a wrench (6,) that is not nothing, got {np.asarray(self.wrench).tolist()}")

    def value(self, q: Floats, arm: Arm) -> Floats:
        """(...,) the multiple at joint values q (..., n) rad; negative, by how much of a limit, where the arm's own
        weight is too much.
        """
        low, high = self.strength.box(q, arm)
        return np.where(
            (low <= 0).all(axis=-1) & (high >= 0).all(axis=-1),
            greatest_load_multiple(joint_torques_for_wrench(q, arm, self.wrench), low, high),
            (np.minimum(high, -low) / self.strength.limits).min(axis=-1),
        )

    def slope(self, q: Floats, arm: Arm) -> Floats:
        """(..., n) derivative of the value with the joint values, by differences: where two joints give out at once it
        has a corner.
        """
        steps = DIFFERENCE * np.eye(np.shape(q)[-1])
        ahead, behind = (self.value(np.asarray(q)[..., None, :] + way * steps, arm) for way in (1, -1))
        return (ahead - behind) / (2 * DIFFERENCE)


def joint_torques_for_wrench(q: Floats, arm: Arm, wrench: Floats) -> Floats:
    """Joint torques (..., n) N m that exert a wrench (6,) N, N m on the surroundings, weight excluded."""
    return np.swapaxes(mechanism.jacobian(q, arm, "base"), -1, -2) @ wrench


def greatest_load_multiple(load: Floats, low: Floats, high: Floats) -> Floats:
    """Greatest multiple (...,) of a load (..., n) within torque limits low, high (..., n) N m."""
    size = np.abs(load)
    loaded = size > FELT * size.max(axis=-1, keepdims=True)
    room = np.where(load > 0, high, -low)
    return np.min(np.where(loaded, room / np.where(loaded, size, 1.0), np.inf), axis=-1)


def force_polytope_corners(A: Floats, low: Floats, high: Floats) -> Floats:
    """Corners (k, 3) N of the force polytope low <= A f <= high, A (n, 3) m, low and high (n,) N m.

    Raises RigError where some force loads no joint, so that the posture bears any amount of it
    """
    if np.linalg.matrix_rank(A, tol=FELT * np.abs(A).max()) < 3:
        blind = np.linalg.svd(A)[2][-1]
        raise RigError(
            f"the posture bears any force along ({', '.join(f'{part:+.2f}' for part in blind)}): it loads no "
            "joint, and there is no "
            "greatest one"
        )
    found = []
    for rows in combinations(range(len(A)), 3):
        part = A[list(rows)]
        if np.linalg.cond(part) > 1 / FELT:
            continue
        sides = np.array(list(product(*((low[i], high[i]) for i in rows))))
        found.append(np.linalg.solve(part, sides.T).T)
    every = np.concatenate(found)
    torque = every @ A.T
    slack = INSIDE * (high - low)
    return every[((torque >= low - slack) & (torque <= high + slack)).all(axis=1)]


def weakest_force_direction(A: Floats, low: Floats, high: Floats) -> tuple[float, Floats]:
    """Weakest force direction: (force N exertable in every direction, (3,) direction of no more)."""
    size = np.linalg.norm(A, axis=1)
    bearing = np.where(size > FELT * size.max(), np.minimum(high, -low) / np.maximum(size, 1e-300), np.inf)
    i = int(bearing.argmin())
    return float(bearing[i]), A[i] / size[i] * (1.0 if high[i] <= -low[i] else -1.0)
