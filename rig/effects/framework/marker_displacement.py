"""Moving some markers of a batch: what the target effects share."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform


def displace_markers(
    poses: RigidTransform, rows: np.ndarray, motion: Callable[[RigidTransform], RigidTransform]
) -> RigidTransform:
    """RigidTransform (m,) with motion(T) in place of T at the rows (m,) bool."""
    if not rows.any():
        return poses
    matrices = poses.as_matrix().copy()
    at = np.flatnonzero(rows)
    matrices[at] = motion(poses[at]).as_matrix()
    return RigidTransform.from_matrix(matrices)
