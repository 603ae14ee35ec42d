"""What was measured of a chain, stage by stage: residuals and derivatives of each for one least squares, and what it
scatters by on its own.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.identify.least_squares import Linear
from calib.models.arm.excess_scatter import beyond
from calib.models.chain import error_model
from calib.samples.pose_samples import Samples
from rig.model.design import Chain
from rig.model.mechanisms import chain as mechanism
from rig.model.pose import pose_difference

# share of the squares that a fit is taken to have followed: where it followed all, nothing is left to tell scatter by
MOST = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """What was measured of one stage: values (m, axes) effective; T (m,); covariance (m, 6, 6); common (m, 6, k);
    stage : None for the last.
    """

    values: np.ndarray
    T: RigidTransform
    covariance: np.ndarray
    common: np.ndarray
    stage: int | None

    def linear(self, chain: Chain, white: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(residual, jacobian, common) as in Linear, at a chain. white : (m, 6, 6); free : (p,) bool"""
        stands = mechanism.stage_poses(self.values, chain)[-1 if self.stage is None else self.stage - 1]
        left = pose_difference(stands, self.T)
        J = error_model.parameter_jacobian(self.values, chain, self.stage)[..., free]
        return (white @ left[..., None])[..., 0], white @ J, white @ self.common

    def scatter(self, white: np.ndarray, residual: np.ndarray, inliers: np.ndarray, hat: np.ndarray) -> np.ndarray:
        """(6,) m and rad of its scatter beyond the instrument's own. residual : (m, 6) whitened; hat : (m, 6, 6) of the
        fit, whitened
        """
        if not inliers.any():
            return np.zeros(6)
        half = np.linalg.inv(white[inliers])
        left = (half @ residual[inliers][..., None])[..., 0]
        gone, whole = (np.einsum("nij,njk,nik->i", half, H, half) for H in (hat[inliers], np.eye(6)[None]))
        share = np.minimum(gone.reshape(2, 3).sum(axis=1) / whole.reshape(2, 3).sum(axis=1), MOST)
        return beyond(left, self.covariance[inliers], share)


def bodies(samples: Samples) -> list[Body]:
    """The last platform, and the stages below it of which some pose was measured."""
    last = Body(samples.effective, samples.T_base_platform, samples.covariance, samples.common, None)
    return [
        last,
        *(
            Body(samples.effective[b.seen], b.T_base_stage[b.seen], b.covariance[b.seen], b.common[b.seen], b.stage)
            for b in samples.below
            if b.seen.any()
        ),
    ]


def leverage(linear: Linear, inliers: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """(n, 6, 6) of every pose, the share of its own noise that a fit follows: what its residual's covariance lacks of
    the identity.

    sigma : (k,) the prior of the parameters
    """
    A = np.concatenate([linear.common, linear.jacobian], axis=2)
    rows = A[inliers].reshape(-1, A.shape[2])
    prior = np.r_[np.ones(linear.common.shape[2]), 1 / sigma**2]
    return A @ np.linalg.solve(rows.T @ rows + np.diag(prior), np.swapaxes(A, 1, 2))
