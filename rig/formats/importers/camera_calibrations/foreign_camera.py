"""What any program's result tells of a camera, checked."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.formats.checked_entries import Entries
from rig.formats.input_files import value_text
from rig.formats.rig_toml.camera_entries import LARGEST_IMAGE
from rig.model.design import DISTORTION_TERMS

ORTHOGONAL = 1e-3  # that a rotation's product with its transpose may differ from one: files have six digits at times


@dataclass(frozen=True, slots=True, eq=False)
class ForeignCamera:
    """name : theirs; size : width and height, px, or None; matrix : (3, 3) px; distortion : OpenCV's order, of a length
    that a rig.toml takes
    T : T_reference_camera, the reference being their own, or None where nothing tells; said : what became of its lens;
        at : where it stands"""

    name: str
    size: tuple[int, int] | None
    matrix: np.ndarray
    distortion: np.ndarray
    T: RigidTransform | None
    at: Entries
    said: tuple[str, ...] = ()


def image_size(e: Entries, key: str) -> tuple[int, int]:
    """(width, height) px of a list. Raises FileError for anything else."""
    found = e.wholes(key, 1)
    if len(found) != 2 or max(found) > LARGEST_IMAGE:
        e.fail(f"{e.name(key)} must be width and height in px, not {value_text(e.get(key))}", key)
    return found[0], found[1]


def camera_matrix(e: Entries, key: str, matrix: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) px, which a rig.toml can hold. Raises FileError for a skew, and for what is no camera's
    matrix.
    """
    off = matrix.copy()
    off[0, 0], off[1, 1], off[:2, 2], off[2, 2] = 0, 0, 0, matrix[2, 2] - 1
    if off[0, 1] and np.count_nonzero(off) == 1:
        e.fail(
            f"{e.name(key)} has a skew of {off[0, 1]:g}, which a camera here has not: calibrate with none",
            key,
            value=off[0, 1],
        )
    if off.any() or min(matrix[0, 0], matrix[1, 1]) <= 0:
        e.fail(
            f"{e.name(key)} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0, not "
            f"{value_text(matrix.tolist())}",
            key,
        )
    return matrix


def distortion_terms(e: Entries, key: str, values: np.ndarray) -> np.ndarray:
    """Distortion terms (n,) of values (n,), none at all being four zeros. Raises FileError for a number of them that
    OpenCV has not.
    """
    if not len(values):
        return np.zeros(4)
    if len(values) not in DISTORTION_TERMS:
        e.fail(
            f"{e.name(key)} must have {', '.join(map(str, DISTORTION_TERMS))} terms in OpenCV's order, got "
            f"{len(values)}",
            key,
        )
    return values


def camera_transform(e: Entries, key: str, R: np.ndarray, t: np.ndarray) -> RigidTransform:
    """RigidTransform of a rotation matrix (3, 3) and a position (3,) m. Raises FileError for a matrix that is no
    rotation.
    """
    worst = max(float(np.abs(R @ R.T - np.eye(3)).max()), abs(float(np.linalg.det(R)) - 1))
    if worst > ORTHOGONAL:
        e.fail(f"{e.name(key)} is no rotation: its product with its transpose is {worst:.2g} away from one", key)
    return RigidTransform.from_components(t, Rotation.from_matrix(R))
