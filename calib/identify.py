"""The hexapod's 42 parameters from measured poses: joint positions and strut zeros, by least squares on the closed loops.

Each strut closes a vector loop: commanded length + zero = |R a + t - b|. Weighted by the poses' covariance, the errors that
all poses share (cameras and lenses) solved for together with the parameters, so that the struts' known lengths steady the
cameras. Source: Masory, Wang and Zhuang, On the accuracy of a Stewart platform, ICRA 1993 (the loop); the shared errors
as nuisance parameters are the exact linear form of one solve of cameras, lenses and geometry.
"""

from dataclasses import dataclass, replace

import numpy as np

from rig.design import Hexapod
from rig.errors import NotEnoughData, RigError
from rig.mechanisms import hexapod as mechanism

PRIOR = 5e-3  # m; how far a joint or a zero may be from where its owner states it: ten times what rigs show
MAX_ITERATIONS = 20
CONVERGED = 1e-11  # m; largest step
ROUNDS = 8  # of weighing struts and poses anew; one that still wavers then stays as it was
GATE = 6.0  # standard deviations of one strut's closure beyond which a pose is left out
EXCESS = 3.0  # standard errors by which scatter must exceed the poses' own before it counts as the struts'


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What a fit of the 42 found.

    hexapod : Hexapod with the fitted geometry; covariance : (42, 42) m^2, order base joints 1..6 (x y z), platform joints
    1..6 (x y z), zeros 1..6; shared : (k,) the draw of the poses' shared errors
    residuals : (n, 6) m, what each strut's loop leaves once the shared errors are taken out; their covariance : (n, 6, 6) m^2
    scatter : (6,) m, scatter of each strut beyond the poses' own; inliers : (n,) bool
    """

    hexapod: Hexapod
    covariance: np.ndarray
    shared: np.ndarray
    residuals: np.ndarray
    residual_covariance: np.ndarray
    scatter: np.ndarray
    inliers: np.ndarray


def identify(samples, nominal, offset=None):
    """Joint positions and strut zeros that explain the measured poses.

    samples : Samples; nominal : Hexapod, where the fit starts and what its weak prior (5 mm) holds
    offset : (n, 6) m or None, known deviations of the struts (commanded less effective), taken off the commands first
    Returns Identified. Raises NotEnoughData for fewer than 7 poses (42 equations), RigError where the fit does not settle.
    """
    if len(samples) < 7:
        raise NotEnoughData(f"{len(samples)} poses cannot determine 42 parameters; it takes 7, better 30")
    lengths = samples.commanded - (0 if offset is None else offset)
    inliers, scatter, found = np.ones(len(samples), bool), np.zeros(6), nominal
    for _ in range(ROUNDS):
        found, shared, covariance, left, S = _settle(samples, lengths, found, nominal, inliers, scatter)
        new_scatter, new_inliers = _scatter(left, S, inliers), _inliers(left, S, scatter)
        if new_inliers.sum() < 7:
            raise NotEnoughData(f"only {new_inliers.sum()} of {len(samples)} poses agree with one geometry")
        if (new_inliers == inliers).all() and np.abs(new_scatter - scatter).max() < 1e-9:
            break
        inliers, scatter = new_inliers, new_scatter
    return Identified(found, covariance, shared, left, S, scatter, inliers)


def _settle(samples, lengths, found, nominal, inliers, scatter):
    """Gauss-Newton for given weights: (hexapod, shared errors, covariance, residuals, their covariance)."""
    for _ in range(MAX_ITERATIONS):
        r, D, B, S = _linearise(samples, lengths, found)
        step, shared, covariance = _solve(r, D, B, S + np.diag(scatter**2), inliers, found, nominal)
        found = _moved(found, step)
        if np.abs(step).max() < CONVERGED:
            return found, shared, covariance, r + np.einsum("nij,j->ni", D, step) - B @ shared, S
    raise RigError(f"the 42 parameters did not settle: the last step was {np.abs(step).max():.3g} m")


def loop_jacobian(T_base_platform, hexapod):
    """(..., 6, 42) change of the struts' closure, zero - length, with the parameters (m/m), at poses RigidTransform (...)."""
    matrix = T_base_platform.as_matrix()
    R = matrix[..., :3, :3]
    struts = hexapod.platform_joints @ np.swapaxes(R, -1, -2) + matrix[..., None, :3, 3] - hexapod.base_joints
    u = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    D = np.zeros((*u.shape[:-2], 6, 42))
    turned = u @ R
    for i in range(6):
        D[..., i, 3 * i : 3 * i + 3] = u[..., i, :]
        D[..., i, 18 + 3 * i : 21 + 3 * i] = -turned[..., i, :]
        D[..., i, 36 + i] = 1
    return D


def pose_jacobian(T_base_platform, hexapod):
    """J_p (..., 6, 42): change of the pose's tangent (m, rad, on the right) with the parameters (m) at constant command.

    delta_e = J_p delta_x; source: the on-line learning patent for Stewart platforms, eq. 1 [0024]
    """
    return np.linalg.solve(mechanism.jacobian(T_base_platform, hexapod), loop_jacobian(T_base_platform, hexapod))


def _linearise(samples, lengths, hexapod):
    """Closure (n, 6) m, its Jacobian to the parameters (n, 6, 42), to the shared errors (n, 6, k), and its covariance."""
    r = lengths - mechanism.inverse(samples.T_base_platform, hexapod)
    A = mechanism.jacobian(samples.T_base_platform, hexapod)
    return r, loop_jacobian(samples.T_base_platform, hexapod), A @ samples.common, A @ samples.covariance @ np.swapaxes(A, 1, 2)


def _solve(r, D, B, S, inliers, found, nominal):
    """Step (42,), shared errors (k,) and the parameters' covariance (42, 42)."""
    W = np.linalg.inv(np.linalg.cholesky(S[inliers]))
    M = (W @ np.concatenate([D, -B], axis=2)[inliers]).reshape(-1, D.shape[2] + B.shape[2])
    right = -(W @ r[inliers][..., None]).ravel()
    offset = np.concatenate([(getattr(found, name) - getattr(nominal, name)).ravel() for name in ("base_joints", "platform_joints", "strut_zeros")])
    count = B.shape[2]
    prior = np.diag(np.r_[np.full(42, 1 / PRIOR), np.ones(count)])
    stacked = np.concatenate([M, prior])
    Q, R = np.linalg.qr(stacked)
    solution = np.linalg.solve(R, Q.T @ np.concatenate([right, np.r_[-offset / PRIOR, np.zeros(count)]]))
    half = np.linalg.inv(R)
    return solution[:42], solution[42:], (half @ half.T)[:42, :42]


def _moved(hexapod, step):
    return replace(hexapod, base_joints=hexapod.base_joints + step[:18].reshape(6, 3),
                   platform_joints=hexapod.platform_joints + step[18:36].reshape(6, 3), strut_zeros=hexapod.strut_zeros + step[36:])


def _scatter(left, S, inliers):
    """(6,) m: what each strut scatters beyond the poses' own covariance, 0 where that suffices."""
    count = inliers.sum()
    own = np.einsum("nii->ni", S)[inliers].mean(axis=0) * max(1 - 7 / count, 0.1)
    seen = (left[inliers] ** 2).mean(axis=0)
    return np.where(seen > own * (1 + EXCESS * np.sqrt(2 / count)), np.sqrt(np.maximum(seen - own, 0)), 0.0)


def _inliers(left, S, scatter):
    sigma = np.sqrt(np.einsum("nii->ni", S) + scatter**2)
    scale = np.maximum(1.0, 1.4826 * np.median(np.abs(left / sigma), axis=0))
    return (np.abs(left) < GATE * scale * sigma).all(axis=1)
