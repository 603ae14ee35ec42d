"""Poses as a GCS hexapod controller takes them: X Y Z in mm, U V W in degrees, each about an axis that moves along.

Source: PI manual MS207E (H-820), 3.7.4: translations are in the fixed frame; the rotational axes move with the
platform, and a rotation is made in the order U, V, W.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats

AXES = ("X", "Y", "Z", "U", "V", "W")
ORDER = "XYZ"  # of SciPy: about axes that move along
MM = 1e3  # per m


def gcs_values_of_pose(T: RigidTransform) -> Floats:
    """(..., 6) X, Y, Z in mm and U, V, W in degrees of poses (...)."""
    return np.concatenate([MM * T.translation, T.rotation.as_euler(ORDER, degrees=True)], axis=-1)


def pose_of_gcs_values(values: ArrayLike) -> RigidTransform:
    """Poses (...) of (..., 6) X, Y, Z in mm and U, V, W in degrees."""
    values = np.asarray(values, float)
    return RigidTransform.from_components(
        values[..., :3] / MM, Rotation.from_euler(ORDER, values[..., 3:], degrees=True)
    )
