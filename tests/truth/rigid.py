"""Rigid motions as 4 x 4 matrices: between pose rows (x, y, z, rx, ry, rz) and matrices, and the error of one against
another.
"""

import numpy as np
from scipy.spatial.transform import Rotation


def matrices(rows: np.ndarray) -> np.ndarray:
    """(n, 4, 4) of pose rows (n, 6), m and rad (rotation vector)."""
    rows = np.atleast_2d(np.asarray(rows, float))
    out = np.zeros((len(rows), 4, 4))
    out[:, :3, :3] = Rotation.from_rotvec(rows[:, 3:]).as_matrix()
    out[:, :3, 3] = rows[:, :3]
    out[:, 3, 3] = 1.0
    return out


def rows_of(poses: np.ndarray) -> np.ndarray:
    """(n, 6) pose rows, m and rad, of matrices (n, 4, 4)."""
    return np.hstack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()])


def displaced(poses: np.ndarray, small: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses moved by small motions (n, 6) in their own frames: translation and rotation vector apart,
    translation first.
    """
    out = poses.copy()
    out[:, :3, 3] += np.einsum("nij,nj->ni", poses[:, :3, :3], small[:, :3])
    out[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(small[:, 3:]).as_matrix()
    return out


def errors(real: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(n, 6) m and rad, where the real poses stand, seen from the wanted ones' own frames; both (n, 4, 4)."""
    back = np.swapaxes(wanted[:, :3, :3], 1, 2)
    turn = Rotation.from_matrix(back @ real[:, :3, :3]).as_rotvec()
    return np.hstack([np.einsum("nij,nj->ni", back, real[:, :3, 3] - wanted[:, :3, 3]), turn])


def rms(error: np.ndarray) -> tuple[float, float]:
    """(position m, rotation rad): root mean square lengths of errors (n, 6)."""
    return float(np.sqrt((error[:, :3] ** 2).sum(axis=1).mean())), float(
        np.sqrt((error[:, 3:] ** 2).sum(axis=1).mean())
    )
