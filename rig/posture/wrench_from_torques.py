"""Wrench at the hand from joint torques: the table of torques read, external torques, least squares.

Source: patent on force measurement with redundant manipulators, [0009]-[0012]: expected torques of weight and motion
are taken from the measured ones; what is left is J^T f.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import scipy

from rig.arrays import Booleans, Floats
from rig.errors import FileError, RigError
from rig.formats import csv_table
from rig.formats.checked_entries import nearest_known_word
from rig.formats.rig_toml.arm_dynamics_entries import ArmDynamics
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms import arm_dynamics
from rig.model.mechanisms.arm_dynamics import Links
from rig.posture.force_transmission import DIRECTIONS
from rig.posture.momentum_observer import Motion
from rig.recording.time_origin import Origin

WINDOW = 11  # readings over which a slope is taken
EVEN = 0.01  # of the time between readings, by which it may differ where slopes are taken of them
REVERSAL = 1e-3  # rad/s or m/s below which Coulomb friction has not its full size


@dataclass(frozen=True, slots=True, eq=False)
class TorqueRecord:
    """k readings of an arm of n joints. motion : Motion of one record, (1, k, n); acceleration : (k, n) rad/s^2, by
    slopes
    acceleration_sigma : (n,) rad/s^2 of these; current : whether torques were told as motor currents"""

    motion: Motion
    acceleration: Floats
    acceleration_sigma: Floats
    current: bool


def load_torque_table(path: Path, arm: Arm, dynamics: ArmDynamics, source: Path) -> TorqueRecord:
    """TorqueRecord loaded from a table t, q1.., tau1.. (N m) or i1.. (A), with speeds v1.. if present.

    source : the arm's file, for what its [dynamics] lacks. Raises FileError with line and column for what cannot be
    used, RigError where currents come without torque_constants
    """
    header, n = csv_table.read(path, ("t", *arm.axes)), len(arm.axes)
    current = "i1" in header.columns
    if current and "tau1" in header.columns:
        raise FileError(path, "has both torques (tau1) and motor currents (i1); keep one", 1)
    names = [f"{'i' if current else 'tau'}{i + 1}" for i in range(n)]
    near = None if current or "tau1" in header.columns else nearest_known_word("tau1", header.columns)
    if near is not None:
        raise FileError(path, f"has no column 'tau1'; is {near!r} meant?", 1, header.columns.index(near) + 1)
    speeds = tuple(f"v{i + 1}" for i in range(n)) if "v1" in header.columns else ()
    rows = csv_table.read(path, ("t", *arm.axes, *names, *speeds))
    t, q, torque = rows.times("t", Origin()), rows.matrix(arm.axes), rows.matrix(names)
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        rows.fail("time must increase from row to row", back[0] + 1, "t")
    if len(t) < WINDOW:
        raise FileError(path, f"has {len(t)} readings; it takes at least {WINDOW}")
    beyond = np.argwhere(np.abs(mechanism.limits(q, arm)) > 0.01 * np.ptp(arm.limits, axis=1))
    if len(beyond):
        i, j = beyond[0].tolist()
        rows.fail(
            f"{arm.axes[j]} is outside the joint's limits: angles are in rad, slides in m", i, arm.axes[j], q[i, j]
        )
    if current:
        torque = torque * dynamics.need("torque_constants", source)
    speed = rows.matrix(speeds) if speeds else _slope(path, t, q, 1)
    if dynamics.friction is not None:
        torque = torque - dynamics.friction[:, 0] * np.tanh(speed / REVERSAL) - dynamics.friction[:, 1] * speed
    motion = Motion(t - t[0], q[None], speed[None], bool(speeds), torque[None])
    return TorqueRecord(motion, *_acceleration(path, motion, dynamics, source), current)


def _acceleration(path: Path, motion: Motion, dynamics: ArmDynamics, source: Path) -> tuple[Floats, Floats]:
    """((k, n) rad/s^2 of what was read, (n,) standard deviation)."""
    dt = float(np.median(np.diff(motion.t)))
    if motion.measured:
        share = np.linalg.norm(scipy.signal.savgol_coeffs(WINDOW, 2, 1, dt))
        return _slope(path, motion.t, motion.speed[0], 1), share * dynamics.need("speed_sigma", source)
    share = np.linalg.norm(scipy.signal.savgol_coeffs(WINDOW, 3, 2, dt))
    return _slope(path, motion.t, motion.q[0], 2), share * dynamics.need("angle_sigma", source)


def _slope(path: Path, t: Floats, values: Floats, order: int) -> Floats:
    """(k, n) first or second derivative of values (k, n), of parabolas or cubics through WINDOW readings. Source:
    Savitzky and Golay 1964
    """
    steps = np.diff(t)
    uneven = np.flatnonzero(np.abs(steps - np.median(steps)) > EVEN * np.median(steps))
    if len(uneven):
        i = int(uneven[0])
        raise RigError(
            f"{path}: readings {i + 1} and {i + 2} are {steps[i]:.6g} s apart, others {np.median(steps):.6g} "
            "s; slopes are taken of even "
            "ones: resample it"
        )
    return scipy.signal.savgol_filter(values, WINDOW, 1 + order, deriv=order, delta=float(np.median(steps)), axis=0)


FELT = 1e-6  # of the largest singular value; a wrench that shows less in the torques is not felt


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """value : (..., 6) fx fy fz (N), mx my mz (Nm) on the hand, at its origin, in the axes of poses; covariance : (...,
    6, 6)
    left : (...,) chi-square of what no wrench explains, with n - 6 degrees of freedom"""

    value: Floats
    covariance: Floats
    left: Floats


def external_joint_torques(
    measured: Floats, q: Floats, speed: Floats, acceleration: Floats, arm: Arm, links: Links, gravity: Floats
) -> Floats:
    """External joint torques (..., n) N m: measured ones less those of weight and motion, tau = J^T f.

    measured : (..., n) Nm, what the joints exert; f is what the surroundings do to the hand. Others as of
        dynamics.torques
    """
    return arm_dynamics.joint_torques(q, speed, acceleration, arm, links, gravity) - measured


def is_wrench_observable(q: Floats, arm: Arm, covariance: Floats) -> Booleans:
    """Whether (...,) every wrench is observable in the joint torques at joint values q (..., n) rad."""
    S = np.linalg.svd(_whitened(mechanism.jacobian(q, arm, "base"), covariance)[1], compute_uv=False)
    return S[..., -1] >= FELT * S[..., 0] if q.shape[-1] >= 6 else np.zeros(S.shape[:-1], bool)


def _whitened(J: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """(what whitens torques (..., n, n), the transpose (..., n, 6) of Jacobians so whitened)."""
    W = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(covariance, (*J.shape[:-2], J.shape[-1], J.shape[-1]))))
    return cast(Floats, W), W @ np.swapaxes(J, -1, -2)


def estimate_wrench(external_torques: Floats, q: Floats, arm: Arm, covariance: Floats) -> Wrench:
    """Wrench estimated from external joint torques (..., n) N m at joint angles q (..., n) rad.

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
