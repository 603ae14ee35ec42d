"""Momentum observer: wrench on a moving arm's hand and its covariance, by a Kalman filter, no acceleration.

A Kalman filter whose state is (joint values, momentum, error of the last torques, wrench): a torque's error acts before
and after its reading.
The wrench wanders like a random walk whose rate is stated or the likeliest.
Sources: patent on force measurement with redundant manipulators, [0009] (momentum observer); Wahrburg, Boes, Listmann,
Dai, Matthias and Ding, Motor-current-based estimation of Cartesian contact forces and torques for robotic manipulators,
T-ASE 2018 (as a filter).
"""

from dataclasses import dataclass
from math import log, pi
from typing import cast

import numpy as np
import scipy

from rig.arrays import Floats
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms import arm_dynamics
from rig.model.mechanisms.arm_dynamics import Links

LARGEST = np.repeat([1e3, 1e2], 3)  # N, N m; standard deviation of a wrench of which nothing is known
FASTEST = 10.0  # rad/s or m/s; the same of speeds
LENGTH = 0.1  # m; a moment's rate over a force's, where one rate is sought
RATES = (-2.0, 4.0)  # decades of N/sqrt(s) among which the likeliest rate is sought
PART = 1500  # readings from which it is sought


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
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
class Model:
    """What the filter takes of a Motion, computed once. inverse : (m, k, n, n) of the mass matrices; push : (m, k, n) N
    m that changes momentum
    jacobian : (m, k, 6, n) in the axes of poses; torque, angle, speed : (n,) variances of readings"""

    motion: Motion
    inverse: Floats
    push: Floats
    jacobian: Floats
    torque: Floats
    angle: Floats
    speed: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """value : (m, k, 6) fx fy fz (N), mx my mz (Nm) on the hand, at its origin, in the axes of poses; covariance : (m,
    k, 6, 6)
    likelihood : logarithm of that of all readings; innovation : RMS of readings less what was expected, in standard
        deviations"""

    value: Floats
    covariance: Floats
    likelihood: float
    innovation: float


def observer_model(
    motion: Motion, arm: Arm, links: Links, gravity: Floats, sigmas: tuple[Floats, Floats, Floats]
) -> Model:
    """Model of the momentum observer for a Motion of an arm, computed once; sigmas : (n,) of torque, angle, speed."""
    inverse = np.linalg.inv(arm_dynamics.mass_matrix(motion.q, arm, links))
    push = motion.torque + arm_dynamics.torque_free_momentum_rate(motion.q, motion.speed, arm, links, gravity)
    torque, angle, speed = (np.square(sigma) for sigma in sigmas)
    return Model(motion, cast(Floats, inverse), push, mechanism.jacobian(motion.q, arm, "base"), torque, angle, speed)


def observe_wrench(model: Model, rates: Floats) -> Observed:
    """Observed wrench of a Model. rates : (6,) N/sqrt(s), Nm/sqrt(s), of the wrench's random walk."""
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
        state, P, (told, square) = _corrected(model, k, state, P)
        likelihood, squares = likelihood + told * (k > 0), squares + square
        value[:, k], covariance[:, k] = state[:, 3 * n :], P[:, 3 * n :, 3 * n :]
    readings = records * count * (2 * n if model.motion.measured else n)
    return Observed(value, covariance, likelihood, float(np.sqrt(squares / readings)))


def _moved(m: Model, k: int, state: Floats, P: Floats, rates: Floats) -> tuple[Floats, Floats]:
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


def _corrected(m: Model, k: int, state: Floats, P: Floats) -> tuple[Floats, Floats, tuple[float, float]]:
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
    told = -0.5 * (squares + float(np.linalg.slogdet(S)[1].sum()) + left.size * log(2 * pi))
    return state, P, (told, squares)


def most_likely_wrench_rates(model: Model) -> Floats:
    """Most likely rates (6,) N/sqrt(s), Nm/sqrt(s) of the wrench's random walk for a Model's readings."""
    motion = model.motion
    part = slice(0, PART)
    short = Model(
        Motion(motion.t[part], motion.q[:, part], motion.speed[:, part], motion.measured, motion.torque[:, part]),
        model.inverse[:, part],
        model.push[:, part],
        model.jacobian[:, part],
        model.torque,
        model.angle,
        model.speed,
    )
    found = scipy.optimize.minimize_scalar(
        lambda decades: -observe_wrench(short, _rates(decades)).likelihood,
        bounds=RATES,
        method="bounded",
        options={"xatol": 0.05},
    )
    return _rates(float(found.x))


def _rates(decades: float) -> Floats:
    return 10.0**decades * np.repeat([1.0, LENGTH], 3)
