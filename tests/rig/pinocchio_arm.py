"""The same arm in an outside library: joints about and along z, links and ends as fixed placements."""

import numpy as np
import pinocchio


def build(arm):
    """(pinocchio Model, placement of the platform on the last joint). theta and d stand before a joint's motion is
    felt, a, alpha and beta behind it, so nothing of our own link formula is used."""
    model = pinocchio.Model()
    parent, placement = 0, _se3(arm.base.as_matrix())
    for i, (theta, d, a, alpha, beta) in enumerate(arm.rows):
        placement = placement * pinocchio.SE3(pinocchio.utils.rotate("z", theta), np.array([0, 0, d]))
        joint = pinocchio.JointModelPZ() if arm.slides[i] else pinocchio.JointModelRZ()
        parent = model.addJoint(parent, joint, placement, f"q{i + 1}")
        placement = pinocchio.SE3(
            pinocchio.utils.rotate("x", alpha) @ pinocchio.utils.rotate("y", beta), np.array([a, 0.0, 0.0])
        )
    return model, placement * _se3(arm.tool.as_matrix())


def poses(arm, q):
    """(m, 4, 4) platform poses of joint angles q (m, n) rad."""
    model, last = build(arm)
    data = model.createData()
    out = np.empty((len(q), 4, 4))
    for i, angles in enumerate(q):
        pinocchio.forwardKinematics(model, data, angles)
        out[i] = (data.oMi[model.njoints - 1] * last).homogeneous
    return out


def _se3(matrix):
    return pinocchio.SE3(matrix[:3, :3], matrix[:3, 3])
