"""Correction map in pose space: pose errors left by earlier corrections, and the pose to request instead.

Source: configuration-space patent, [0035] (error maps and compensation in the configuration space, the workspace or
    both)
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.interpolation.field import Field
from rig.arrays import Floats
from rig.errors import NotConverged
from rig.model.pose import exp, log

ITERATIONS = 50
TOLERANCE = 1e-13  # m and rad, of the error's last change
NAMES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True, eq=False)
class PoseMap:
    """home : T_base_platform whose turn rotations are counted from; coordinates : of NAMES, indices of those that poses
    differ in
    field : Field over these, position in the base frame (m) and rotation vector from home (rad), whose values are the
    tangent on the right (m, rad) from where a pose is asked for to where the machine stands then, in the same
    coordinates."""

    home: RigidTransform
    coordinates: tuple[int, ...]
    field: Field

    def at(self, T: RigidTransform) -> Floats:
        """(..., k) coordinates of poses (...)."""
        return pose_coordinates(T, self.home)[..., list(self.coordinates)]

    def error(self, T: RigidTransform) -> Floats:
        """(..., 6) m and rad, standard error of what the map adds to poses (...)."""
        return self._whole(self.field.error(self.at(T)))

    def applied(self, T: RigidTransform) -> RigidTransform:
        """Where the machine stands (...) when it is taken to stand at poses (...)."""
        return T * exp(self._whole(self.field.value(self.at(T))))

    def compensated(self, T: RigidTransform) -> RigidTransform:
        """The poses (...) at which the machine is to be taken to stand for it to stand at T (...): the fixed point of
        T' = T exp(-error(T')).

        Raises NotConverged with index, poses and residual (m, rad) where it is not found
        """
        found, before = T, np.zeros((*T.shape, 6))
        for _ in range(ITERATIONS):
            now = self._whole(self.field.value(self.at(found)))
            found, change, before = T * exp(-now), np.abs(now - before).max(axis=-1), now
            if change.max(initial=0) < TOLERANCE:
                return found
        failed = np.flatnonzero(~(np.ravel(change) < TOLERANCE))
        raise NotConverged(
            f"where to stand for {len(failed)} poses was not found by a map in pose space",
            failed,
            pose_coordinates(T, self.home).reshape(-1, 6)[failed],
            np.ravel(change)[failed],
        )

    def _whole(self, values: Floats) -> Floats:
        out = np.zeros((*values.shape[:-1], 6))
        out[..., list(self.coordinates)] = values
        return out


def pose_coordinates(T: RigidTransform, home: RigidTransform) -> Floats:
    """Coordinates (..., 6) of poses (...): position (m) and rotation vector (rad) from home's orientation."""
    return np.concatenate([T.translation, (home.rotation.inv() * T.rotation).as_rotvec()], axis=-1)


def pose_error_tangents(T_expected: RigidTransform, T_measured: RigidTransform) -> Floats:
    """Tangents (n, 6) of pose errors, m and rad, on the right: from the expected to the measured pose."""
    return log(T_expected.inv() * T_measured)
