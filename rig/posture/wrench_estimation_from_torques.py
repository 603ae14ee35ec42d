"""Wrench estimation at an arm's hand from joint torques.

By least squares, or in motion by a momentum observer.

A Kalman filter whose state is (joint values, momentum, error of the last torques, wrench): a torque's error acts before
and after its reading.
The wrench wanders like a random walk whose rate is stated or the likeliest.
Sources: patent on force measurement with redundant manipulators, [0009] (momentum observer); Wahrburg, Boes, Listmann,
Dai, Matthias and Ding, Motor-current-based estimation of Cartesian contact forces and torques for robotic manipulators,
T-ASE 2018 (as a filter).

Source: patent on force measurement with redundant manipulators, [0009]-[0012]: expected torques of weight and motion
are taken from the measured ones; what is left is J^T f.
"""

from dataclasses import dataclass
from math import log, pi
from pathlib import Path
from typing import cast

import numpy as np
import scipy

from rig.array_and_json_types import Booleans, Floats
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.checked_toml_and_json_entries import nearest_known_word
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.formats.rig_toml.arm_dynamics_entries import ArmDynamics
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import LinkMasses
from rig.posture.arm_force_transmission_and_exertable_wrench import DIRECTIONS

LARGEST = np.repeat([1e3, 1e2], 3)  # N, N m; standard deviation of a wrench of which nothing is known
FASTEST = 10.0  # rad/s or m/s; the same of speeds
LENGTH = 0.1  # m; a moment's rate over a force's, where one rate is sought
RATES = (-2.0, 4.0)  # decades of N/sqrt(s) among which the likeliest rate is sought
PART = 1500  # readings from which it is sought


@dataclass(frozen=True, slots=True, eq=False)
class ArmMotion:
    """Readings of an arm of n joints at k times, m records at once or one.

    t : (k,) s; q : (m, k, n) rad; speed : (m, k, n) rad/s; measured : whether speeds were read, not worked out of q
    torque : (m, k, n) N m that the joints exert, friction taken off
    """

    t: Floats
    q: Floats
    speed: Floats
    measured: bool
    torque: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ObserverModel:
    """What the filter takes of a Motion, computed once. inverse : (m, k, n, n) of the mass matrices; push : (m, k, n) N
    m that changes momentum
    jacobian : (m, k, 6, n) in the axes of poses; torque, angle, speed : (n,) variances of readings"""

    motion: ArmMotion
    inverse: Floats
    push: Floats
    jacobian: Floats
    torque: Floats
    angle: Floats
    speed: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ObservedWrench:
    """value : (m, k, 6) fx fy fz (N), mx my mz (Nm) on the hand, at its origin, in the axes of poses; covariance : (m,
    k, 6, 6)
    likelihood : logarithm of that of all readings; innovation : RMS of readings less what was expected, in standard
        deviations"""

    value: Floats
    covariance: Floats
    likelihood: float
    innovation: float


def momentum_observer_model(
    motion: ArmMotion, arm: Arm, links: LinkMasses, gravity: Floats, sigmas: tuple[Floats, Floats, Floats]
) -> ObserverModel:
    """Model (ObserverModel) of the momentum observer for an ArmMotion.

    sigmas : (n,) of torque, angle, speed
    """
    inverse = np.linalg.inv(arm_dynamics_and_step_by_step_kinematics.mass_matrix(motion.q, arm, links))
    push = motion.torque + arm_dynamics_and_step_by_step_kinematics.torque_free_momentum_rate(
        motion.q, motion.speed, arm, links, gravity
    )
    torque, angle, speed = (np.square(sigma) for sigma in sigmas)
    return ObserverModel(
        motion, cast(Floats, inverse), push, mechanism.jacobian(motion.q, arm, "base"), torque, angle, speed
    )


def wrench_by_momentum_observer(model: ObserverModel, rates: Floats) -> ObservedWrench:
    """External wrench over time (ObservedWrench) by the momentum observer.

    rates : (6,) N/sqrt(s), Nm/sqrt(s), of the wrench's random walk
    Returns ObservedWrench
    """
    records, count, n = model.motion.q.shape
    size = 3 * n + 6
    state = np.zeros((records, size))
    state[:, :n] = model.motion.q[:, 0]
    P = np.zeros((records, size, size))
    mass = np.linalg.inv(model.inverse[:, 0])
    P[:, :n, :n] = np.diag(model.angle) * 1e6
    P[:, n : 2 * n, n : 2 * n] = FASTEST**2 * mass @ np.swapaxes(mass, 1, 2)
    P[:, 2 * n : 3 * n, 2 * n : 3 * n], P[:, 3 * n :, 3 * n :] = np.diag(model.torque), np.diag(LARGEST**2)
    value, covariance = np.empty((records, count, 6)), np.empty((records, count, 6, 6))
    likelihood = squares = 0.0
    for k in range(count):
        if k:
            state, P = _moved(model, k, state, P, np.square(rates))
        state, P, (log_likelihood, square) = _corrected(model, k, state, P)
        likelihood, squares = likelihood + log_likelihood * (k > 0), squares + square
        value[:, k], covariance[:, k] = state[:, 3 * n :], P[:, 3 * n :, 3 * n :]
    readings = records * count * (2 * n if model.motion.measured else n)
    return ObservedWrench(value, covariance, likelihood, float(np.sqrt(squares / readings)))


def _moved(m: ObserverModel, k: int, state: Floats, P: Floats, rates: Floats) -> tuple[Floats, Floats]:
    """State (records, 3 n + 6) and covariance a step on. Between two readings torques, their errors, the wrench and
    speeds are their mean.
    """
    n, dt, size = m.motion.q.shape[2], m.motion.t[k] - m.motion.t[k - 1], state.shape[1]
    q, p, w, f = slice(0, n), slice(n, 2 * n), slice(2 * n, 3 * n), slice(3 * n, size)
    felt, push = np.swapaxes(m.jacobian[:, k - 1] + m.jacobian[:, k], 1, 2) / 2, (m.push[:, k - 1] + m.push[:, k]) / 2
    half = dt / 2 * m.inverse[:, k]  # of the new momentum into joint values
    F = np.zeros((len(state), size, size))
    F[:, p, p], F[:, p, w], F[:, p, f], F[:, f, f] = np.eye(n), -dt / 2 * np.eye(n), dt * felt, np.eye(6)
    F[:, q] = half @ F[:, p]
    F[:, q, p] += dt / 2 * m.inverse[:, k - 1]
    F[:, q, q] += np.eye(n)
    G = np.zeros((len(state), size, n + 6))  # of the new torques' errors and the wrench's step
    G[:, p, :n], G[:, p, n:], G[:, w, :n], G[:, f, n:] = -dt / 2 * np.eye(n), dt / 2 * felt, np.eye(n), np.eye(6)
    G[:, q] = half @ G[:, p]
    state = (F @ state[..., None])[..., 0]
    state[:, p] += dt * push
    state[:, q] += (half @ (dt * push)[..., None])[..., 0]
    return state, F @ P @ np.swapaxes(F, 1, 2) + (G * np.concatenate([m.torque, rates * dt])) @ np.swapaxes(G, 1, 2)


def _corrected(m: ObserverModel, k: int, state: Floats, P: Floats) -> tuple[Floats, Floats, tuple[float, float]]:
    """(state, covariance, (log likelihood, squares) of the readings) with the angles, and the speeds where they were
    read.
    """
    n = m.motion.q.shape[2]
    H = np.zeros((len(state), 2 * n if m.motion.measured else n, state.shape[1]))
    H[:, :n, :n] = np.eye(n)
    read, R = m.motion.q[:, k], m.angle
    if m.motion.measured:
        H[:, n:, n : 2 * n] = m.inverse[:, k]
        read, R = np.concatenate([read, m.motion.speed[:, k]], axis=1), np.concatenate([R, m.speed])
    left = read - (H @ state[..., None])[..., 0]
    S = H @ P @ np.swapaxes(H, 1, 2) + np.diag(R)
    gain = np.swapaxes(np.linalg.solve(S, H @ P), 1, 2)
    state = state + (gain @ left[..., None])[..., 0]
    keep = np.eye(state.shape[1]) - gain @ H
    P = keep @ P @ np.swapaxes(keep, 1, 2) + (gain * R) @ np.swapaxes(gain, 1, 2)
    squares = float(np.einsum("mi,mi->", left, np.linalg.solve(S, left[..., None])[..., 0]))
    log_likelihood = -0.5 * (squares + float(np.linalg.slogdet(S)[1].sum()) + left.size * log(2 * pi))
    return state, P, (log_likelihood, squares)


def most_likely_random_walk_rates(model: ObserverModel) -> Floats:
    """Most likely rates (6,) of the wrench's random walk.

    In N/sqrt(s), Nm/sqrt(s), for an ObserverModel's readings.
    """
    motion = model.motion
    part = slice(0, PART)
    short = ObserverModel(
        ArmMotion(motion.t[part], motion.q[:, part], motion.speed[:, part], motion.measured, motion.torque[:, part]),
        model.inverse[:, part],
        model.push[:, part],
        model.jacobian[:, part],
        model.torque,
        model.angle,
        model.speed,
    )
    found = scipy.optimize.minimize_scalar(
        lambda decades: -wrench_by_momentum_observer(short, _rates(decades)).likelihood,
        bounds=RATES,
        method="bounded",
        options={"xatol": 0.05},
    )
    return _rates(float(found.x))


def _rates(decades: float) -> Floats:
    return 10.0**decades * np.repeat([1.0, LENGTH], 3)


WINDOW = 11  # readings over which a slope is taken
EVEN = 0.01  # of the time between readings, by which it may differ where slopes are taken of them
REVERSAL = 1e-3  # rad/s or m/s below which Coulomb friction has not its full size


@dataclass(frozen=True, slots=True, eq=False)
class TorqueRecord:
    """k readings of an arm of n joints. motion : Motion of one record, (1, k, n); acceleration : (k, n) rad/s^2, by
    slopes
    acceleration_sigma : (n,) rad/s^2 of these; current : whether torques were told as motor currents"""

    motion: ArmMotion
    acceleration: Floats
    acceleration_sigma: Floats
    current: bool


def load_torque_table(path: Path, arm: Arm, dynamics: ArmDynamics, source: Path) -> TorqueRecord:
    """Load a table of torques as a TorqueRecord.

    Columns t, q1.., tau1.. (N m) or i1.. (A), with speeds v1.. if present.
    source : the arm's file, for what its [dynamics] lacks. Raises FileError with line and column for what cannot be
    used, RigError where currents come without torque_constants
    """
    header, n = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("t", *arm.axes)), len(arm.axes)
    current = "i1" in header.columns
    if current and "tau1" in header.columns:
        raise FileError(path, "has both torques (tau1) and motor currents (i1); keep one", 1)
    names = [f"{'i' if current else 'tau'}{i + 1}" for i in range(n)]
    near = None if current or "tau1" in header.columns else nearest_known_word("tau1", header.columns)
    if near is not None:
        raise FileError(path, f"has no column 'tau1'; is {near!r} meant?", 1, header.columns.index(near) + 1)
    speeds = tuple(f"v{i + 1}" for i in range(n)) if "v1" in header.columns else ()
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("t", *arm.axes, *names, *speeds))
    t, q, torque = rows.times("t", TimeOrigin()), rows.matrix(arm.axes), rows.matrix(names)
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        rows.fail("time must increase from row to row", back[0] + 1, "t")
    if len(t) < WINDOW:
        raise FileError(path, f"has {len(t)} readings; it requires at least {WINDOW}")
    beyond = np.argwhere(np.abs(mechanism.signed_limit_excess(q, arm)) > 0.01 * np.ptp(arm.limits, axis=1))
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
    motion = ArmMotion(t - t[0], q[None], speed[None], bool(speeds), torque[None])
    return TorqueRecord(motion, *_acceleration(path, motion, dynamics, source), current)


def _acceleration(path: Path, motion: ArmMotion, dynamics: ArmDynamics, source: Path) -> tuple[Floats, Floats]:
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
            "s; slopes require even "
            "ones: resample it"
        )
    return scipy.signal.savgol_filter(values, WINDOW, 1 + order, deriv=order, delta=float(np.median(steps)), axis=0)


FELT = 1e-6  # of the largest singular value; a wrench that shows less in the torques is not felt


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedWrench:
    """value : (..., 6) fx fy fz (N), mx my mz (Nm) on the hand, at its origin, in the axes of poses; covariance : (...,
    6, 6)
    left : (...,) chi-square of what no wrench explains, with n - 6 degrees of freedom"""

    value: Floats
    covariance: Floats
    left: Floats


def external_joint_torques(
    measured: Floats, q: Floats, speed: Floats, acceleration: Floats, arm: Arm, links: LinkMasses, gravity: Floats
) -> Floats:
    """External joint torques (..., n) N m.

    Measured ones less those of weight and motion, tau = J^T f.
    measured : (..., n) Nm, what the joints exert; f is what the surroundings do to the hand. Others as of
        dynamics.torques
    """
    return (
        arm_dynamics_and_step_by_step_kinematics.joint_torques(q, speed, acceleration, arm, links, gravity) - measured
    )


def is_wrench_observable(q: Floats, arm: Arm, covariance: Floats) -> Booleans:
    """Whether (...,) a wrench is observable in the joint torques at joint values q (..., n) rad."""
    S = np.linalg.svd(_whitened(mechanism.jacobian(q, arm, "base"), covariance)[1], compute_uv=False)
    return S[..., -1] >= FELT * S[..., 0] if q.shape[-1] >= 6 else np.zeros(S.shape[:-1], bool)


def _whitened(J: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """(what whitens torques (..., n, n), the transpose (..., n, 6) of Jacobians so whitened)."""
    W = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(covariance, (*J.shape[:-2], J.shape[-1], J.shape[-1]))))
    return cast(Floats, W), W @ np.swapaxes(J, -1, -2)


def estimate_wrench(external_torques: Floats, q: Floats, arm: Arm, covariance: Floats) -> EstimatedWrench:
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
            f"{len(blind)} of {S[..., 0].size} postures cannot sense every wrench; posture {blind[0]} is "
            f"blind to ({named})"
        )
    inverse = np.swapaxes(V, -1, -2) @ (np.swapaxes(U, -1, -2) / S[..., None])
    white = (W @ np.asarray(external_torques, float)[..., None])[..., 0]
    value = (inverse @ white[..., None])[..., 0]
    left = white - (A @ value[..., None])[..., 0]
    return EstimatedWrench(value, inverse @ np.swapaxes(inverse, -1, -2), (left**2).sum(axis=-1))
