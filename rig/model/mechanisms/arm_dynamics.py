"""Joint torques, and forces of slides, of an arm's own weight and motion: recursive Newton-Euler, in the axes of poses,
batched.

Source: Luh, Walker and Paul, On-line computational scheme for mechanical manipulators, 1980 (sliding joints: there
    too).
"""

from dataclasses import dataclass

import numpy as np

from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """mass : (n,) kg; centre : (n, 3) m, centre of mass in the link's Denavit-Hartenberg frame (the one behind its
    joint)
    inertia : (n, 3, 3) kg m^2 about the centre of mass, in that frame's axes. What the hand holds belongs to the last
        link."""

    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.mass)
        if np.shape(self.centre) != (n, 3) or np.shape(self.inertia) != (n, 3, 3) or (np.asarray(self.mass) < 0).any():
            raise ValueError(
                f"expected masses (n,) >= 0, centres ({n}, 3) and inertias ({n}, 3, 3), got {np.shape(self.centre)}, "
                f"{np.shape(self.inertia)}"
            )


def joint_torques(
    q: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, arm: Arm, links: Links, gravity: np.ndarray
) -> np.ndarray:
    """(..., n) Nm, of slides N, that the joints bear for weight and motion alone: nothing touches the hand.

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
