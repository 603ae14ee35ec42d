"""Two struts in a plane as a problem of least squares: where the hinge was measured against where its two circles
cross.

Only the hinge's place in the plane is the struts' to give; what was measured across the plane, and how the plate on the
hinge is turned, is no part of the fit.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.identify.least_squares import Linear
from calib.samples.pose_samples import Samples
from rig.errors import NotConverged, RigError
from rig.model.design import Planar2
from rig.model.mechanisms import two_strut_plane


def loop_jacobian(T_base_platform: RigidTransform, mechanism: Planar2) -> np.ndarray:
    """(..., 2, 6) change of the struts' closures, zero - length, with base joints and zeros (m/m), at poses
    RigidTransform (...).
    """
    struts = T_base_platform.translation[..., None, :2] - mechanism.base_joints
    u = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    out = np.zeros((*u.shape[:-1], 6))
    for i in range(2):
        out[..., i, 2 * i : 2 * i + 2] = u[..., i, :]
        out[..., i, 4 + i] = 1
    return out


def linear(samples: Samples, lengths: np.ndarray, mechanism: Planar2, scatter: np.ndarray) -> Linear:
    """least_squares.Linear of the measured hinge (x, y) at a geometry.

    lengths : (n, 2) m, commanded; scatter : (2,) m of each strut beyond the poses' own
    Raises RigError naming the first pose whose circles do not cross, or that does not say where in the plane it is
    """
    try:
        T = two_strut_plane.forward(lengths, mechanism)
    except NotConverged as error:
        i = int(error.index[0])
        raise RigError(
            f"frame {samples.frame[i]}: the commanded lengths {lengths[i].round(6).tolist()} m close on no pose"
        ) from None
    R = samples.T_base_platform.rotation.as_matrix()
    to_hinge = np.linalg.inv(two_strut_plane.jacobian(T, mechanism)[..., :2])
    own = (R @ samples.covariance[:, :3, :3] @ np.swapaxes(R, 1, 2))[:, :2, :2] + (to_hinge * scatter**2) @ np.swapaxes(
        to_hinge, 1, 2
    )
    white = np.linalg.inv(np.linalg.cholesky(own))
    left = (samples.T_base_platform.translation - T.translation)[:, :2]
    return Linear(
        (white @ left[..., None])[..., 0],
        white @ to_hinge @ loop_jacobian(T, mechanism),
        white @ (R @ samples.common[:, :3])[:, :2],
    )
