"""Random hexapods and poses of theirs, and derivatives of the pose by differences."""

import numpy as np

from calib.models.platform import strut_loop_closure_equations
from rig.model.design import Hexapod
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.model.pose import exp, pose

REGULAR = 50.0  # greatest condition number of the struts' Jacobian, lengths over the platform's radius


def machine(rng):
    """(Hexapod, pose) drawn at random: joints anywhere near two circles, zeros, a tilted and shifted pose, far from
    singular.
    """
    while True:
        size = rng.uniform(0.1, 2.0)
        base, platform = (
            size * radius * _ring(rng, half) + 0.05 * size * rng.normal(size=(6, 3))
            for radius, half in ((1.0, 0.25), (0.65, 0.8))
        )
        home = pose([0, 0, size * rng.uniform(0.9, 1.8)], [0, 0, 0])
        m = Hexapod(base, platform, np.tile([1e-3, 10 * size], (6, 1)), home, 1e-3 * rng.normal(size=6))
        T = home * exp(np.r_[0.15 * size * rng.normal(size=3), 0.2 * rng.normal(size=3)])
        A = hexapod.jacobian(T, m) / np.r_[1, 1, 1, np.full(3, 0.65 * size)]
        if np.linalg.cond(A) < REGULAR:
            return m, T


def _ring(rng, half):
    angles = np.array([2 * np.pi * k / 3 + side * half for k in range(3) for side in (-1, 1)]) + 0.1 * rng.normal(
        size=6
    )
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1)


def by_differences(m, T, step=1e-5):
    """(6, 42) change of the pose at constant command with each parameter: central differences of the forward
    kinematics, two
    steps extrapolated to none. step : over the machine's radius"""
    command, p, start = hexapod.inverse(T, m), geometric_parameters(m), T.as_matrix()
    h = step * np.linalg.norm(m.base_joints, axis=1).mean()
    out, e = np.empty((6, 42)), np.empty((4, 6))
    for k in range(42):
        for side, sign in enumerate((-2, -1, 1, 2)):
            moved, R, t = p.copy(), start[:3, :3].copy(), start[:3, 3].copy()
            moved[k] += sign * h
            assert strut_loop_closure_equations.solve_pose_in_place_by_newton(command, moved, R, t)
            strut_loop_closure_equations.fill_pose_error(start[:3, :3], start[:3, 3], R, t, e[side])
        out[:, k] = (8 * (e[2] - e[1]) - (e[3] - e[0])) / (12 * h)
    return out


def worst_jacobian(count, seed):
    """Greatest relative disagreement, of the whole matrix, between J_p and differences over `count` random machines and
    poses.
    """
    from calib.models.platform.platform_identification import pose_parameter_jacobian

    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(count):
        m, T = machine(rng)
        J = pose_parameter_jacobian(T, m)
        scale = np.r_[np.ones(3), np.full(3, np.linalg.norm(m.platform_joints, axis=1).mean())][:, None]
        worst = max(worst, np.linalg.norm((by_differences(m, T) - J) * scale) / np.linalg.norm(J * scale))
    return worst
