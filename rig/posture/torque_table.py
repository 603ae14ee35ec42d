"""A table of an arm's torques, or motor currents, with its joint values in time -> what a wrench is worked out from,
each reading's error too.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from rig.errors import FileError, RigError
from rig.formats import csv_table
from rig.formats.checked_entries import slip
from rig.formats.rig_toml.arm_dynamics import ArmDynamics
from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism
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
    acceleration: np.ndarray
    acceleration_sigma: np.ndarray
    current: bool


def load_torque_table(path: Path, arm: Arm, dynamics: ArmDynamics, source: Path) -> TorqueRecord:
    """TorqueRecord of a table t, q1.., tau1.. (N m) or i1.. (A), and speeds v1.. (rad/s) where there are any.

    source : the arm's file, for what its [dynamics] lacks. Raises FileError with line and column for what cannot be
    used, RigError where currents come without torque_constants
    """
    header, n = csv_table.read(path, ("t", *arm.axes)), len(arm.axes)
    current = "i1" in header.columns
    if current and "tau1" in header.columns:
        raise FileError(path, "has both torques (tau1) and motor currents (i1); keep one", 1)
    names = [f"{'i' if current else 'tau'}{i + 1}" for i in range(n)]
    near = None if current or "tau1" in header.columns else slip("tau1", header.columns)
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


def _acceleration(path: Path, motion: Motion, dynamics: ArmDynamics, source: Path) -> tuple[np.ndarray, np.ndarray]:
    """((k, n) rad/s^2 of what was read, (n,) standard deviation)."""
    dt = float(np.median(np.diff(motion.t)))
    if motion.measured:
        share = np.linalg.norm(scipy.signal.savgol_coeffs(WINDOW, 2, 1, dt))
        return _slope(path, motion.t, motion.speed[0], 1), share * dynamics.need("speed_sigma", source)
    share = np.linalg.norm(scipy.signal.savgol_coeffs(WINDOW, 3, 2, dt))
    return _slope(path, motion.t, motion.q[0], 2), share * dynamics.need("angle_sigma", source)


def _slope(path: Path, t: np.ndarray, values: np.ndarray, order: int) -> np.ndarray:
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
