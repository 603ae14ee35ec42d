"""Measuring limbs as they were fitted: six that tell the pose, the others that check it."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.platform.identification import pose_jacobian
from rig.model.design import Hexapod
from rig.model.mechanisms import hexapod as mechanism


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """k limbs beyond the six. limbs : (k,) their numbers among all, from 0; base, platform : (k, 3) m; zeros : (k,) m
    covariance : (k, 7, 7) m^2 of base joint, platform joint and zero; sigma : (k,) m of a reading, what the fit leaves
        included"""

    limbs: np.ndarray
    base: np.ndarray
    platform: np.ndarray
    zeros: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Limbs:
    """A measuring rig that can be read: hexapod : Hexapod of the six limbs that tell poses; covariance : (42, 42) m^2
    of that; sigma : (6,) m of a reading; chosen : (6,) their numbers among all limbs, from 0; checks : Checks, the
    others, or None where nobody has fitted them"""

    hexapod: Hexapod
    covariance: np.ndarray
    sigma: np.ndarray
    chosen: np.ndarray = field(default_factory=lambda: np.arange(6))
    checks: Checks | None = None

    def pose(self, lengths: np.ndarray, guess: RigidTransform | None = None) -> RigidTransform:
        """T_base_platform (...) of readings (..., limbs) m. Raises NotConverged like the mechanism."""
        return mechanism.forward(np.asarray(lengths)[..., self.chosen], self.hexapod, guess)

    def uncertainty(self, T_base_platform: RigidTransform) -> tuple[np.ndarray, np.ndarray]:
        """(own (..., 6, 6) covariance of a pose's readings, common (..., 6, 42) factor of what the limbs' geometry adds
        to all poses).
        """
        back = np.linalg.inv(mechanism.jacobian(T_base_platform, self.hexapod))
        own = back @ np.diag(self.sigma**2) @ np.swapaxes(back, -1, -2)
        half = np.linalg.cholesky((self.covariance + self.covariance.T) / 2)
        return own, pose_jacobian(T_base_platform, self.hexapod) @ half
