"""Dynamics of an arm: joint torques of weight and motion (Newton-Euler), mass matrix, change of momentum.

Source: Luh, Walker and Paul, On-line computational scheme for mechanical manipulators, 1980 (sliding joints: there
    too).

d(M v)/dt = tau + C^T v - g + J^T f, which needs no acceleration. Source: De Luca and Mattone, Actuator failure
detection and isolation using generalized momenta, ICRA 2003.
"""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Floats
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """mass : (n,) kg; centre : (n, 3) m, centre of mass in the link's Denavit-Hartenberg frame (the one behind its
    joint)
    inertia : (n, 3, 3) kg m^2 about the centre of mass, in that frame's axes. What the hand holds belongs to the last
        link."""

    mass: Floats
    centre: Floats
    inertia: Floats

    def __post_init__(self) -> None:
        n = len(self.mass)
        if np.shape(self.centre) != (n, 3) or np.shape(self.inertia) != (n, 3, 3) or (np.asarray(self.mass) < 0).any():
            raise ValueError(
                f"expected masses (n,) >= 0, centres ({n}, 3) and inertias ({n}, 3, 3), got {np.shape(self.centre)}, "
                f"{np.shape(self.inertia)}"
            )


def joint_torques(q: Floats, speed: Floats, acceleration: Floats, arm: Arm, links: Links, gravity: Floats) -> Floats:
    """(..., n) N m (slides: N) joint torques for an arm's weight and motion alone, with nothing at the hand.

    q : (..., n) rad, of slides m; speed, acceleration : (..., n) of these per s and s^2; gravity : (3,) m/s^2 in the
        axes of poses
    """
    chain = mechanism.frames(q, arm)
    speed, acceleration = np.broadcast_to(speed, np.shape(q)), np.broadcast_to(acceleration, np.shape(q))
    n = len(arm.joints)
    z, o, R = chain[..., :n, :3, 2], chain[..., : n + 1, :3, 3], chain[..., 1 : n + 1, :3, :3]
    centre = np.einsum("...nij,nj->...ni", R, links.centre) + o[..., 1:, :]
    inertia = R @ links.inertia @ np.swapaxes(R, -1, -2)
    zero = np.zeros(z.shape[:-2] + (3,))
    w, dw, a = zero, zero, zero - np.asarray(gravity, float)
    push, turn = [], []
    for k in range(n):
        axis, rate = z[..., k, :], speed[..., k, None]
        to_centre, to_next = centre[..., k, :] - o[..., k, :], o[..., k + 1, :] - o[..., k, :]
        if arm.slides[k]:
            a = a + axis * acceleration[..., k, None] + 2 * np.cross(w, axis * rate)
        else:
            dw = dw + axis * acceleration[..., k, None] + np.cross(w, axis * rate)
            w = w + axis * rate
        push.append(links.mass[k] * (a + np.cross(dw, to_centre) + np.cross(w, np.cross(w, to_centre))))
        spin = np.einsum("...ij,...j->...i", inertia[..., k, :, :], w)
        turn.append(np.einsum("...ij,...j->...i", inertia[..., k, :, :], dw) + np.cross(w, spin))
        a = a + np.cross(dw, to_next) + np.cross(w, np.cross(w, to_next))
    force, moment, out = zero, zero, np.empty(z.shape[:-1])
    for k in range(n - 1, -1, -1):
        moment = (
            moment
            + turn[k]
            + np.cross(centre[..., k, :] - o[..., k, :], push[k])
            + np.cross(o[..., k + 1, :] - o[..., k, :], force)
        )
        force = force + push[k]
        out[..., k] = np.einsum("...i,...i->...", z[..., k, :], force if arm.slides[k] else moment)
    return out


STEP = 1e-5  # rad or m, along the motion, for the mass matrix's rate: its error is of the square, below 1e-10
NO_GRAVITY = np.zeros(3)


def mass_matrix(q: Floats, arm: Arm, links: Links) -> Floats:
    """Mass matrix (..., n, n) kg m^2 at joint values q (..., n) rad (slides: m, and kg)."""
    columns = [
        joint_torques(q, np.zeros(np.shape(q)), np.broadcast_to(e, np.shape(q)), arm, links, NO_GRAVITY)
        for e in np.eye(np.shape(q)[-1])
    ]
    return np.stack(columns, axis=-1)


def torque_free_momentum_rate(q: Floats, speed: Floats, arm: Arm, links: Links, gravity: Floats) -> Floats:
    """Rate (..., n) N m of an arm's momentum without joint torques and hand wrench: C^T v - g.

    q, speed : (..., n) rad and rad/s; gravity : (3,) m/s^2 in the axes of poses
    """
    still, ahead = np.zeros(np.shape(q)), STEP * np.asarray(speed, float)
    pull = joint_torques(q, speed, still, arm, links, gravity)  # C v + g
    momentum = [joint_torques(q + way * ahead, still, speed, arm, links, NO_GRAVITY) for way in (1, -1)]
    return (momentum[0] - momentum[1]) / (2 * STEP) - pull  # C^T v = (dM/dt) v - C v
