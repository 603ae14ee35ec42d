"""The hexapod's 42 parameters from measured poses: joint positions and strut zeros, by least squares on the poses they predict.

Each strut closes a vector loop: commanded length + zero = |R a + t - b|. The measured pose less the one that the loops predict is
weighted by the poses' covariance; the errors that all poses share (cameras and lenses) are solved for together with the
parameters, so that the struts' known lengths steady the cameras. Source: Masory, Wang and Zhuang, On the accuracy of a Stewart
platform, ICRA 1993 (the loop); the shared errors as nuisance parameters are the linear form of one solve of cameras, lenses and
geometry (calib/identify/with_cameras.py).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2, norm

from calib.identify import closed_loop
from calib.identify.least_squares import Fit, Linear, fit
from calib.samples import Samples
from rig.errors import NotEnoughData, RigError
from rig.design import Hexapod
from rig.mechanisms import hexapod as mechanism

PRIOR = 5e-3  # m; how far a joint or a zero may be from where its owner states it: ten times what rigs show
ROUNDS = 8  # of weighing struts and poses anew; one that still wavers then stays as it was
LEAST = 7  # poses from which struts may scatter, and on which a geometry must stand where there are so many
GATE = 6.0  # standard deviations of one strut's closure beyond which a pose is left out
EXCESS = 3.0  # standard deviations of chance that scatter must exceed before it counts as the struts'
NAMES = (*(f"{plate} joint {i + 1} {axis}" for plate in ("base", "platform") for i in range(6) for axis in "xyz"),
         *(f"zero of strut {i + 1}" for i in range(6)))


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What a fit of the 42 found.

    hexapod : Hexapod with the fitted geometry; covariance : (42, 42) m^2, order as NAMES; shared : (k,) the draw of the poses'
    shared errors; root : (42, 42) 1/m, square root of the information in the poses alone
    residuals : (n, 6) m, what each strut's loop leaves once the shared errors are taken out; their covariance : (n, 6, 6) m^2
    scatter : (6,) m, scatter of each strut beyond the poses' own; inliers : (n,) bool
    prior : (42,) m, standard deviation that the owner's figures were given; cost : whitened squares of data, shared draw and prior
    """

    hexapod: Hexapod
    covariance: np.ndarray
    shared: np.ndarray
    root: np.ndarray
    residuals: np.ndarray
    residual_covariance: np.ndarray
    scatter: np.ndarray
    inliers: np.ndarray
    prior: np.ndarray
    cost: float


def parameters(hexapod: Hexapod) -> np.ndarray:
    """(42,) m, joints and zeros of a Hexapod in the order of NAMES."""
    return np.concatenate([hexapod.base_joints.ravel(), hexapod.platform_joints.ravel(), hexapod.strut_zeros])


def with_parameters(hexapod: Hexapod, p: np.ndarray) -> Hexapod:
    """The Hexapod with parameters p (42,) m."""
    return replace(hexapod, base_joints=p[:18].reshape(6, 3), platform_joints=p[18:36].reshape(6, 3), strut_zeros=p[36:])


def identify(samples: Samples, nominal: Hexapod, offset: np.ndarray | None = None, prior: np.ndarray | None = None) -> Identified:
    """Joint positions and strut zeros that explain the measured poses, as near to the owner's as these allow, docs/mathematics.md (7).

    samples : Samples; nominal : Hexapod, where the fit starts and where its prior holds what the poses do not tell
    offset : (n, 6) m or None, known deviations of the struts (commanded less effective), taken off the commands first
    prior : (42,) m, standard deviation that the owner's figures are given, 5 mm each by default
    Returns Identified. Raises NotEnoughData where too few poses agree, RigError where the fit does not settle.
    """
    lengths = samples.effective - (0 if offset is None else offset)
    prior = np.full(42, PRIOR) if prior is None else np.asarray(prior, float)
    loops = Loops(samples, lengths, nominal, prior)
    inliers, scatter, p = np.ones(len(samples), bool), np.zeros(6), parameters(nominal)
    for _ in range(ROUNDS):
        found = loops.fit(p, inliers, scatter)
        p = found.parameters
        left, S = loops.closure(found)
        new_scatter, new_inliers = _scatter(left, S, inliers), _inliers(left, S, scatter)
        if new_inliers.sum() < min(LEAST, len(samples) / 2):
            raise NotEnoughData(f"only {new_inliers.sum()} of {len(samples)} poses agree with one geometry")
        if (new_inliers == inliers).all() and np.abs(new_scatter - scatter).max() < 1e-9:
            break
        inliers, scatter = new_inliers, new_scatter
    return Identified(with_parameters(nominal, p), found.covariance, found.shared, found.root, left, S, scatter, inliers, prior, found.cost)


class Loops:
    """The samples of a machine as a problem of least squares, for given weights; keeps the predicted poses to start from again."""

    def __init__(self, samples: Samples, lengths: np.ndarray, nominal: Hexapod, prior: np.ndarray) -> None:
        """samples : Samples; lengths : (n, 6) m, commanded; nominal : Hexapod, the prior's middle; prior : (42,) m, its width"""
        self.prior, self.samples, self.lengths, self.nominal = prior, samples, np.ascontiguousarray(lengths, float), nominal
        measured, home = samples.T_base_platform.as_matrix(), nominal.home.as_matrix()
        self.measured = closed_loop.Measured(*(np.ascontiguousarray(part, float) for part in (measured[:, :3, :3], measured[:, :3, 3],
                                                                                              samples.covariance)))
        self.R, self.t = np.tile(home[:3, :3], (len(samples), 1, 1)), np.tile(home[:3, 3], (len(samples), 1))

    def fit(self, start: np.ndarray, inliers: np.ndarray, scatter: np.ndarray) -> Fit:
        """least_squares.Fit from parameters start (42,). inliers : (n,) bool; scatter : (6,) m"""
        return fit(lambda p: self.linearise(p, scatter), start, parameters(self.nominal), self.prior, inliers=inliers)

    def linearise(self, p: np.ndarray, scatter: np.ndarray) -> Linear:
        """least_squares.Linear at parameters p (42,). Raises RigError naming the first pose that has no solution there."""
        common = self.samples.common
        right, J = np.empty((len(self.lengths), 6, 1 + common.shape[2])), np.zeros((len(self.lengths), 6, 42))
        right[..., 1:] = common
        bad = closed_loop.rows(self.lengths, self.R, self.t, p, self.measured, scatter**2, right, J)
        if bad >= 0:
            raise RigError(f"frame {self.samples.frame[bad]}: the commanded lengths {self.lengths[bad].round(6).tolist()} m close on no pose, "
                           "or its covariance is none")
        return Linear(right[..., 0], J, right[..., 1:])

    def closure(self, found: Fit) -> tuple[np.ndarray, np.ndarray]:
        """(n, 6) m what each strut's loop leaves at the fit, shared errors taken out, and its covariance (n, 6, 6) m^2 from the poses'."""
        T, geometry = self.samples.T_base_platform, with_parameters(self.nominal, found.parameters)
        A = mechanism.jacobian(T, geometry)
        left = self.lengths - mechanism.inverse(T, geometry) + np.einsum("nij,njk,k->ni", A, self.samples.common, found.shared)
        return left, A @ self.samples.covariance @ np.swapaxes(A, 1, 2)


def loop_jacobian(T_base_platform: RigidTransform, hexapod: Hexapod) -> np.ndarray:
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


def pose_jacobian(T_base_platform: RigidTransform, hexapod: Hexapod) -> np.ndarray:
    """J_p (..., 6, 42): change of the pose's tangent (m, rad, on the right) with the parameters (m) at constant command.

    delta_e = J_p delta_x, docs/mathematics.md (7); source: the on-line learning patent for Stewart platforms, eq. 1 [0024]
    """
    return np.linalg.solve(mechanism.jacobian(T_base_platform, hexapod), loop_jacobian(T_base_platform, hexapod))


def _scatter(left: np.ndarray, S: np.ndarray, inliers: np.ndarray) -> np.ndarray:
    """(6,) m: what each strut scatters beyond the poses' own covariance, 0 where that suffices."""
    count = inliers.sum()
    if count <= LEAST:
        return np.zeros(6)
    own = np.einsum("nii->ni", S)[inliers].mean(axis=0) * max(1 - 7 / count, 0.1)
    seen = (left[inliers] ** 2).mean(axis=0)
    freedom = count - 7
    return np.where(seen > own * chi2.isf(norm.sf(EXCESS), freedom) / freedom, np.sqrt(np.maximum(seen - own, 0)), 0.0)


def _inliers(left: np.ndarray, S: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    sigma = np.sqrt(np.einsum("nii->ni", S) + scatter**2)
    scale = np.maximum(1.0, 1.4826 * np.median(np.abs(left / sigma), axis=0))
    return (np.abs(left) < GATE * scale * sigma).all(axis=1)
