"""Arms that several tests use: published nominal figures, and one at random."""

import numpy as np

from rig.model.design import Arm
from rig.model.pose import pose
from rig.planning.layout import shipped_arms_and_layouts

HALF = np.pi / 2
UR10 = Arm(
    [
        [0, 0.1273, 0, HALF],
        [0, 0, -0.612, 0],
        [0, 0, -0.5723, 0],
        [0, 0.163941, 0, HALF],
        [0, 0.1157, 0, -HALF],
        [0, 0.0922, 0, 0],
    ],
    [[-2 * np.pi, 2 * np.pi]] * 6,
)
SEVEN = Arm(
    [
        [0, 0.34, 0, -HALF],
        [0, 0, 0, HALF],
        [0, 0.4, 0, HALF],
        [0, 0, 0, -HALF],
        [0, 0.4, 0, -HALF],
        [0, 0, 0, HALF],
        [0, 0.126, 0, 0],
    ],
    np.radians([[-170, 170], [-120, 120], [-170, 170], [-120, 120], [-170, 170], [-120, 120], [-175, 175]]),
)
SCARA, GANTRY, STANFORD = (
    shipped_arms_and_layouts.load_shipped_arm_design(name).mechanism for name in ("scara", "gantry", "stanford")
)


def random_arm(rng, joints=6, slides=()):
    """An Arm of random rows, Hayati's beta among them, somewhere in the world with something in its hand. slides : of
    which joints
    """
    rows = rng.uniform(-1, 1, (joints, 5)) * [3, 0.5, 0.5, 3, 0.5]
    return Arm(
        rows,
        [[-3, 3]] * joints,
        pose(rng.normal(size=3), rng.normal(size=3)),
        pose(0.2 * rng.normal(size=3), rng.normal(size=3)),
        np.isin(np.arange(joints), slides),
    )


def configurations(arm, count, rng, share=1.0):
    """(count, n) rad all over the limits, or over a share of them."""
    low, high = arm.limits.T
    middle, half = (low + high) / 2, (high - low) / 2
    return middle + share * half * rng.uniform(-1, 1, (count, len(low)))
