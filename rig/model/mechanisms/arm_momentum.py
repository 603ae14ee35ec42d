"""An arm's generalised momentum and what changes it: mass matrix, weight, and the part of Coriolis and centrifugal
torques that momentum keeps.

d(M v)/dt = tau + C^T v - g + J^T f, which needs no acceleration. Source: De Luca and Mattone, Actuator failure
detection and isolation using generalized momenta, ICRA 2003.
"""

import numpy as np

from rig.model.design import Arm
from rig.model.mechanisms import arm_dynamics
from rig.model.mechanisms.arm_dynamics import Links

STEP = 1e-5  # rad or m, along the motion, for the mass matrix's rate: its error is of the square, below 1e-10
NO_GRAVITY = np.zeros(3)


def mass_matrix(q: np.ndarray, arm: Arm, links: Links) -> np.ndarray:
    """(..., n, n) kg m^2 at joint values q (..., n) rad (slides: m, and kg)."""
    columns = [
        arm_dynamics.joint_torques(q, np.zeros(np.shape(q)), np.broadcast_to(e, np.shape(q)), arm, links, NO_GRAVITY)
        for e in np.eye(np.shape(q)[-1])
    ]
    return np.stack(columns, axis=-1)


def momentum_drift(q: np.ndarray, speed: np.ndarray, arm: Arm, links: Links, gravity: np.ndarray) -> np.ndarray:
    """(..., n) N m: C^T v - g, what changes momentum beside the joints' torques and a wrench on the hand.

    q, speed : (..., n) rad and rad/s; gravity : (3,) m/s^2 in the axes of poses
    """
    still, ahead = np.zeros(np.shape(q)), STEP * np.asarray(speed, float)
    pull = arm_dynamics.joint_torques(q, speed, still, arm, links, gravity)  # C v + g
    momentum = [arm_dynamics.joint_torques(q + way * ahead, still, speed, arm, links, NO_GRAVITY) for way in (1, -1)]
    return (momentum[0] - momentum[1]) / (2 * STEP) - pull  # C^T v = (dM/dt) v - C v
