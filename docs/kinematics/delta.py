"""Linear delta: three carriages on upright rails, from each a pair of bars to a platform that stays level."""

import numpy as np

from rig.model.mechanisms import Axis, Parameter

axes = (Axis("q1", "m", 0.27, 0.43), Axis("q2", "m", 0.27, 0.43), Axis("q3", "m", 0.27, 0.43))
ANGLES = np.radians([90.0, 210.0, 330.0])
parameters = (
    Parameter("rails", 0.20 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), "m", 5e-4),  # x y of each at height 0
    Parameter("bars", [0.30, 0.30, 0.30], "m", 5e-4),
    Parameter("zeros", [0.0, 0.0, 0.0], "m", 5e-4),  # of the carriages' heights
    Parameter("joints", 0.05 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), "m", 0.0),  # on the platform
)
freedoms = ("x", "y", "z")
home = (0.0, 0.0, 0.09, 0.0, 0.0, 0.0)


def inverse(pose: np.ndarray, p: dict[str, np.ndarray]) -> np.ndarray:
    """Heights of the carriages (..., 3) m of poses (..., 4, 4)."""
    xy = pose[..., None, :2, 3] + p["joints"] - p["rails"]
    return pose[..., None, 2, 3] + np.sqrt(p["bars"] ** 2 - (xy**2).sum(axis=-1)) - p["zeros"]
