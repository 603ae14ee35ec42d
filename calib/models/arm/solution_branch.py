"""Which of an arm's joint solutions a pose takes: that to which a visited configuration leads when its hand goes there
straight.

A solver that starts far away comes down on one solution or another by how its first steps are rounded; along short
steps, each damped, the joints follow the hand, and the same joints come out in whatever frame poses are given.
Source: Nakamura and Hanafusa, Inverse kinematic solutions with singularity robustness, ASME JDSMC 1986 (the damping)
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.pose import exp, pose_difference

STEP = (0.05, 0.1)  # m, rad; of the hand
MOST = 60  # steps of a way
REPEATS = 2  # corrections of the joints at each
DAMPING = 0.03  # m or rad, against singular values of a Jacobian


def solution_from_start(T_base_platform: RigidTransform, arm: Arm, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(q (m, n) rad or m, left (m,) m or rad): joint values of poses (m,) to which the joints come from starts (m, n);
    left as `arm.solve`.
    """
    q = np.array(start, float)
    begin = mechanism.forward(q, arm)
    way = pose_difference(begin, T_base_platform)
    length = np.stack(
        [np.linalg.norm(way[:, part], axis=1) / size for part, size in zip((slice(0, 3), slice(3, 6)), STEP)]
    )
    steps = np.clip(np.ceil(length.max(axis=0)), 1, MOST)
    for k in range(1, int(steps.max(initial=0)) + 1):
        going = np.flatnonzero(steps >= k)
        at = begin[going] * exp((k / steps[going])[:, None] * way[going])
        for _ in range(REPEATS):
            J = mechanism.jacobian(q[going], arm)
            error = pose_difference(mechanism.forward(q[going], arm), at)
            Jt = np.swapaxes(J, 1, 2)
            q[going] += (Jt @ np.linalg.solve(J @ Jt + DAMPING**2 * np.eye(6), error[..., None]))[..., 0]
    q, left = mechanism.solve(T_base_platform, arm, q, starts=0)
    return mechanism.nearest_turn(q, arm, start), left
