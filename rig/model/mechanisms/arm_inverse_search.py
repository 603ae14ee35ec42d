"""The joint solutions of a pose that many starts lead to, each once, for arms without a closed form; of few joints
those that come nearest.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms import deficient_arm

STARTS = 64
SAME = 1e-3  # rad or m; solutions nearer to each other are one
FAR = 0.05  # m and rad, that few joints may leave of a pose


class Solutions(NamedTuple):
    """q : (k, n) rad or m; rest : (k, 6) m and rad, tangent on the right that few joints leave; missed : (m, rad) how
    near the nearest comes.
    """

    q: np.ndarray
    rest: np.ndarray
    missed: tuple[float, float]


def inverse_solutions(T_base_platform: RigidTransform, arm: Arm, starts: int = STARTS) -> Solutions:
    """Solutions of one pose () of an Arm, those within the limits first; of a redundant arm some of the many that there
    are.
    """
    n, (low, high) = len(arm.joints), arm.limits.T
    begin = np.random.default_rng(0).uniform(low, high, (starts, n))
    many = RigidTransform.from_matrix(np.tile(T_base_platform.as_matrix(), (starts, 1, 1)))
    if n < deficient_arm.WHOLE:
        count = deficient_arm.reachable_directions(arm)
        q, rest, settled = deficient_arm.nearest_configuration(many, arm, begin, count)
        place, turn = np.linalg.norm(rest[:, :3], axis=1), np.linalg.norm(rest[:, 3:], axis=1)
        good = settled & (place <= (mechanism.GOOD if count.position == 3 else FAR)) & (turn <= FAR)
    else:
        q, left = mechanism.solve(many, arm, begin, starts=0)
        rest, place, turn, good = np.zeros((starts, 6)), left, left, left <= mechanism.GOOD
    q = mechanism.nearest_turn(q, arm, np.zeros(q.shape))
    order = np.argsort(np.abs(mechanism.limits(q, arm)).max(axis=1) > 0, kind="stable")
    kept = _once(q, [int(k) for k in order if good[k]], arm)
    nearest = int(np.argmin(np.maximum(place, turn)))
    return Solutions(q[kept], rest[kept], (float(place[nearest]), float(turn[nearest])))


def _once(q: np.ndarray, order: list[int], arm: Arm) -> list[int]:
    """Of indices into q (m, n) in an order those that are apart, whole turns aside."""
    kept: list[int] = []
    for k in order:
        if all(np.abs(mechanism.joint_difference(q[k], q[other], arm)).max() >= SAME for other in kept):
            kept.append(k)
    return kept
