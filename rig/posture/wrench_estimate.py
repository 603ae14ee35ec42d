"""Force and moment at the hand from joint torques: the pseudo-inverse of J^T, what it leaves uncertain, what it cannot
feel.

Source: patent on force measurement with redundant manipulators, [0009]-[0012]: expected torques of weight and motion
are taken from the measured ones; what is left is J^T f.
"""

from dataclasses import dataclass

import numpy as np

from rig.errors import RigError
from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms import arm_dynamics
from rig.model.mechanisms.arm_dynamics import Links
from rig.posture.force_transmission import DIRECTIONS

FELT = 1e-6  # of the largest singular value; a wrench that shows less in the torques is not felt


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """value : (..., 6) fx fy fz (N), mx my mz (Nm) on the hand, at its origin, in the axes of poses; covariance : (...,
    6, 6)
    left : (...,) chi-square of what no wrench explains, with n - 6 degrees of freedom"""

    value: np.ndarray
    covariance: np.ndarray
    left: np.ndarray


def external(
    measured: np.ndarray,
    q: np.ndarray,
    speed: np.ndarray,
    acceleration: np.ndarray,
    arm: Arm,
    links: Links,
    gravity: np.ndarray,
) -> np.ndarray:
    """(..., n) Nm: joint torque sensors' readings less what weight and motion explain, with the sign of tau = J^T f.

    measured : (..., n) Nm, what the joints exert; f is what the surroundings do to the hand. Others as of
        dynamics.torques
    """
    return arm_dynamics.joint_torques(q, speed, acceleration, arm, links, gravity) - measured


def is_wrench_observable(q: np.ndarray, arm: Arm, covariance: np.ndarray) -> np.ndarray:
    """(...,) bool: whether every wrench shows in the torques at joint values q (..., n) rad. covariance : as for
    `estimate_wrench`
    """
    S = np.linalg.svd(_whitened(mechanism.jacobian(q, arm, "base"), covariance)[1], compute_uv=False)
    return S[..., -1] >= FELT * S[..., 0] if q.shape[-1] >= 6 else np.zeros(S.shape[:-1], bool)


def _whitened(J: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(what whitens torques (..., n, n), the transpose (..., n, 6) of Jacobians so whitened)."""
    W = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(covariance, (*J.shape[:-2], J.shape[-1], J.shape[-1]))))
    return W, W @ np.swapaxes(J, -1, -2)


def estimate_wrench(external_torques: np.ndarray, q: np.ndarray, arm: Arm, covariance: np.ndarray) -> Wrench:
    """Wrench that explains the external torques (..., n) Nm at joint angles q (..., n) rad.

    covariance : (n, n) or (..., n, n) Nm^2 of the torques, sensors and what is not known of weight and motion together;
        torques
    are whitened by it, so that with equal sensors this is the plain pseudo-inverse of J^T
    Raises RigError where a posture does not feel some wrench, naming it: take another posture first
    """
    W, A = _whitened(mechanism.jacobian(q, arm, "base"), covariance)
    U, S, V = np.linalg.svd(A, full_matrices=False)
    blind = np.flatnonzero(np.ravel(S[..., -1] < FELT * S[..., 0]) if A.shape[-2] >= 6 else np.ones(S[..., 0].size))
    if len(blind):
        wrench = V.reshape(-1, *V.shape[-2:])[blind[0], -1]
        named = ", ".join(f"{name} {part:+.2f}" for name, part in zip(DIRECTIONS, wrench) if abs(part) > 0.05)
        raise RigError(
            f"{len(blind)} of {S[..., 0].size} postures do not feel every wrench; posture {blind[0]} is "
            f"blind to ({named})"
        )
    inverse = np.swapaxes(V, -1, -2) @ (np.swapaxes(U, -1, -2) / S[..., None])
    white = (W @ np.asarray(external_torques, float)[..., None])[..., 0]
    value = (inverse @ white[..., None])[..., 0]
    left = white - (A @ value[..., None])[..., 0]
    return Wrench(value, inverse @ np.swapaxes(inverse, -1, -2), (left**2).sum(axis=-1))
