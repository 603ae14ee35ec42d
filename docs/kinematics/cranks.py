"""Six rotary cranks: each turns in an upright plane and pushes the platform by a rod of fixed length."""

import numpy as np

from rig.model.mechanisms import Axis, Parameter

BASE = np.radians([25.0, 95.0, 145.0, 215.0, 265.0, 335.0])
PLATE = np.radians([50.0, 70.0, 170.0, 190.0, 290.0, 310.0])
PIVOTS = 0.20 * np.stack([np.cos(BASE), np.sin(BASE), np.zeros(6)], axis=1)
JOINTS = 0.14 * np.stack([np.cos(PLATE), np.sin(PLATE), np.zeros(6)], axis=1)
AZIMUTHS = BASE + np.pi / 2 * np.tile([-1.0, 1.0], 3)  # to which the cranks point when level
ARM, HEIGHT = 0.06, 0.25
TIPS = PIVOTS + ARM * np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), np.zeros(6)], axis=1)
RODS = np.linalg.norm(JOINTS + [0, 0, HEIGHT] - TIPS, axis=1)

axes = tuple(Axis(f"q{i + 1}", "rad", -0.7, 0.7) for i in range(6))
parameters = (
    Parameter("pivots", PIVOTS, "m", 5e-4),
    Parameter("azimuths", AZIMUTHS, "rad", 1e-3),
    Parameter("arms", np.full(6, ARM), "m", 5e-4),
    Parameter("rods", RODS, "m", 5e-4),
    Parameter("joints", JOINTS, "m", 5e-4),  # on the platform
    Parameter("zeros", np.zeros(6), "rad", 3e-3),
)
home = (0.0, 0.0, HEIGHT, 0.0, 0.0, 0.0)


def inverse(pose: np.ndarray, p: dict[str, np.ndarray]) -> np.ndarray:
    """Angles of the cranks (..., 6) rad of poses (..., 4, 4)."""
    joints = p["joints"] @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3] - p["pivots"]
    level = joints[..., 0] * np.cos(p["azimuths"]) + joints[..., 1] * np.sin(p["azimuths"])
    reach = 2 * p["arms"] * np.hypot(level, joints[..., 2])
    share = ((joints**2).sum(axis=-1) + p["arms"] ** 2 - p["rods"] ** 2) / reach
    return np.arctan2(joints[..., 2], level) - np.arccos(share) - p["zeros"]
