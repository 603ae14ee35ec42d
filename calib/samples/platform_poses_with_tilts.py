"""Platform poses combined with tilt sensor readings.

What tilt sensors on a platform add: the two angles against gravity, weighted by their covariance.

How the sensors are mounted, and where gravity points in the frame of poses, are solved for with the errors that all
poses share; what these leave uncertain is shared by all poses again. To first order this is the posterior of normal
errors.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.base_and_link_tilts import TiltReadings, linearised_tilts
from rig.model.pose import exp

ROUNDS = 5  # of linearising about the poses and the mounting, and of weighing readings
GATE = 6.0  # standard deviations beyond which a reading is left out
GONE = 1e6  # rad, standard deviation of a reading that is left out


def poses_with_platform_tilts(
    readings: TiltReadings, T: RigidTransform, own: Floats, common: Floats, measured: str = "pose"
) -> tuple[RigidTransform, Floats, Floats]:
    """Poses of a platform with its tilts.

    Measured so, with what tilt sensors on it add.
    own, common : covariance of each pose and factor of what all share; measured : what was, as of Samples
    Readings that scatter more than poses and sensors explain count for less; one that is far off does not count.

    Returns (poses (n,), own (n, 6, 6), common (n, 6, j)) of a platform
    Raises RigError where less than poses was measured
    """
    if measured != "pose":
        raise RigError(
            f"[[tilt_sensor]]s on a platform add to poses, and this recording measures a {measured} alone: leave them "
            "out of rig.toml"
        )
    n, s = len(own), len(readings.sensors)
    sigma = np.where(np.repeat(readings.usable, 2, axis=1), np.repeat([one.sigma for one in readings.sensors], 2), GONE)
    prior = np.r_[readings.mounting_sigma, np.ones(common.shape[2])]
    x, xi, many = np.zeros(len(prior)), np.zeros((n, 6)), len(readings.mounting_sigma)
    for _ in range(ROUNDS):
        R = (T * exp(xi)).rotation.as_matrix()
        left, turns, columns = linearised_tilts(readings, np.repeat(R[:, None], s, axis=1), x[:many])
        J = np.concatenate([np.zeros((n, 2 * s, 3)), (turns @ R[:, None]).reshape(n, 2 * s, 3)], axis=2)
        N = np.concatenate([columns.reshape(n, 2 * s, -1), J @ common], axis=2)
        r = left.reshape(n, 2 * s) + np.einsum("nij,nj->ni", J, xi) + columns.reshape(n, 2 * s, -1) @ x[:many]
        S = J @ own @ np.swapaxes(J, 1, 2) + np.einsum("ni,ij->nij", sigma**2, np.eye(2 * s))
        W = np.linalg.inv(S)
        H = np.einsum("nia,nij,njb->ab", N, W, N) + np.diag(prior**-2)
        factor = cho_factor(H)
        x = cho_solve(factor, np.einsum("nia,nij,nj->a", N, W, r))
        rest = r - N @ x
        K = own @ np.swapaxes(J, 1, 2) @ W
        xi = np.einsum("nij,nj->ni", K, rest) + common @ x[many:]
        sigma = _weighed(rest, S, sigma, s)
    half = np.linalg.cholesky(cho_solve(factor, np.eye(len(prior))))
    shared = np.pad(common, ((0, 0), (0, 0), (many, 0))) - K @ N
    left_own = own - K @ J @ own
    return T * exp(xi), (left_own + np.swapaxes(left_own, 1, 2)) / 2, shared @ half


def _weighed(rest: Floats, S: Floats, sigma: Floats, sensors: int) -> Floats:
    """(n, 2 s) rad, standard deviations of readings, so far sigma, by what a fit leaves of them, rest (n, 2 s) rad.

    S : (n, 2 s, 2 s) of what it leaves, as expected
    """
    out = sigma.copy()
    for k in range(sensors):
        part = slice(2 * k, 2 * k + 2)
        used = sigma[:, part].max(axis=1) < GONE
        expected = np.sqrt(np.einsum("nii->ni", S[:, part, part]))
        off = np.abs(rest[:, part]) / expected
        scale = max(1.0, 1.4826 * float(np.median(off[used]))) if used.any() else 1.0
        wild = (off > GATE * scale).any(axis=1)
        more = np.sqrt(np.maximum((scale**2 - 1) * np.median(expected[used] ** 2), 0.0)) if used.any() else 0.0
        out[:, part] = np.where((wild | ~used)[:, None], GONE, np.hypot(sigma[:, part], more))
    return out
