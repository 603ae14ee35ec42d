"""Hexaglide: six carriages on level rails along x, a strut of fixed length from each to the platform."""

import numpy as np

from rig.model.mechanisms import Axis, Parameter

HALF = np.array([[-0.20, 0.04, 0.0], [0.30, 0.26, 0.0], [0.21, 0.22, 0.0]])  # carriages at home, on one side
ANGLES = np.radians([80.0, 15.0, 120.0])  # of the joints on the platform, on that side
MIRROR = np.array([1.0, -1.0, 1.0])
RAILS = np.concatenate([HALF, HALF * MIRROR])
PLATE = 0.12 * np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(3)], axis=1)
JOINTS = np.concatenate([PLATE, PLATE * MIRROR])
HEIGHT = 0.25
STRUTS = np.linalg.norm(JOINTS + [0, 0, HEIGHT] - RAILS, axis=1)
SIDES = np.sign((JOINTS - RAILS)[:, 0])  # on which side of its carriage a joint lies

axes = tuple(Axis(f"q{i + 1}", "m", -0.06, 0.06) for i in range(6))
parameters = (
    Parameter("rails", RAILS, "m", [0.0, 5e-4, 5e-4]),  # a point of each; along x it is the zero of the carriage
    Parameter("directions", np.zeros((6, 2)), "rad", 1e-3),  # of the rails: their slopes in y and z
    Parameter("zeros", np.zeros(6), "m", 5e-4),
    Parameter("struts", STRUTS, "m", 5e-4),
    Parameter("joints", JOINTS, "m", 5e-4),  # on the platform
)
home = (0.0, 0.0, HEIGHT, 0.0, 0.0, 0.0)


def inverse(pose: np.ndarray, p: dict[str, np.ndarray]) -> np.ndarray:
    """Places of the carriages (..., 6) m along their rails of poses (..., 4, 4)."""
    joints = p["joints"] @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]
    rail = np.concatenate([np.ones((6, 1)), p["directions"]], axis=1)
    rail = rail / np.sqrt((rail**2).sum(axis=1, keepdims=True))
    apart = joints - p["rails"]
    along = (apart * rail).sum(axis=-1)
    across = (apart**2).sum(axis=-1) - along**2
    return along - SIDES * np.sqrt(p["struts"] ** 2 - across) - p["zeros"]
