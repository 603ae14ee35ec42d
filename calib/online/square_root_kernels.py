"""Compiled kernels of the square-root information filter: one pose taken in, sums for jumps updated.

The state is a triangle [R | z | signatures]: R dp = z about the present estimate, moved so that z is zero. A pose adds
six whitened rows; Householder reflections bring the triangle back, and what they leave in the rows is the whitened
innovation, docs/mathematics.md (22).
A column of signatures, carried along, leaves there what a change since a given pose would add to it, less what the
parameters would have made of it: their inner products are the likelihood ratio of the change, (23). Source: Bierman,
Factorization Methods for Discrete Sequential Estimation, 1977; Willsky and Jones, IEEE Trans. Automatic Control 21,
1976 (the ratio).
"""

from typing import NamedTuple

import numpy as np

from calib.models.platform.closed_loop_equations import Measured, forward_kinematics_kernel, whitened_pose_row
from calib.online.change_detection import JUMP, MOVED, WINDOW
from rig.arrays import Floats
from rig.compute.numba_kernels import njit

KINDS = 12  # signatures of an onset: six struts, six motions of the measuring frame against the base
REFUSED, QUIET, ALARM = 0, 1, 2  # what `learn` says
LEAST = MOVED[2]  # innovations squared below which no hypothesis of change_detection.py but a strut's can hold
SUMS = (
    1 + KINDS + KINDS * KINDS + 1
)  # per onset: innovation squared, its products with the signatures, the signatures' own, poses


class Pose(NamedTuple):
    """One pose to learn. number : from 0; command : (6,) m; R : (3, 3) and t : (3,) m, measured; covariance : (6, 6)
    tangent on the right;
    common : (6, c) factor of the errors that all poses share."""

    number: int
    command: Floats
    R: Floats
    t: Floats
    covariance: Floats
    common: Floats


class Machine(NamedTuple):
    """What does not change. home : (4, 4), where forward kinematics starts; variance : (6,) m^2 of each strut beyond
    the poses' covariance.
    """

    home: Floats
    variance: Floats


class Estimate(NamedTuple):
    """What the poses so far tell. p : (42,) m, parameters; s : (c,) shared draw; S : (c + 42, c + 43 + KINDS WINDOW)
    triangle, about p and s;
    sums : (WINDOW, SUMS), of the onset that began at each of the last poses."""

    p: Floats
    s: Floats
    S: Floats
    sums: Floats


@njit(cache=True)
def _absorb(S: Floats, rows: Floats) -> None:
    """Householder reflections: the upper triangle S (k, w) takes in rows (m, w), whose first k columns become zero."""
    k, width, m = S.shape[0], S.shape[1], rows.shape[0]
    dot = np.empty(width)
    for j in range(k):
        square = 0.0
        for i in range(m):
            square += rows[i, j] ** 2
        if square == 0.0:
            continue
        first = S[j, j]
        length = np.sqrt(first**2 + square)
        alpha = -length if first > 0 else length
        v = first - alpha
        beta = 2 / (v**2 + square)
        for c in range(j + 1, width):
            dot[c] = v * S[j, c]
        for i in range(m):
            f = rows[i, j]
            for c in range(j + 1, width):
                dot[c] += f * rows[i, c]
        for c in range(j + 1, width):
            dot[c] *= beta
            S[j, c] -= v * dot[c]
        for i in range(m):
            f = rows[i, j]
            for c in range(j + 1, width):
                rows[i, c] -= f * dot[c]
            rows[i, j] = 0.0
        S[j, j] = alpha


@njit(cache=True)
def _frame_motion(R: Floats, t: Floats, out: Floats) -> None:
    """Into out (6, 6): the pose's tangent on the right by the base's tangent on the left, at pose R (3, 3), t (3,)."""
    out[:] = 0.0
    for i in range(3):
        for k in range(3):
            out[i, k] = R[k, i]
            out[3 + i, 3 + k] = R[k, i]
        out[i, 3] = R[2, i] * t[1] - R[1, i] * t[2]
        out[i, 4] = R[0, i] * t[2] - R[2, i] * t[0]
        out[i, 5] = R[1, i] * t[0] - R[0, i] * t[1]


@njit(cache=True)
def update_estimate(p: Floats, s: Floats, S: Floats) -> None:
    """Update the estimate p (42,), s (c,) to that of the triangle S; its right side becomes zero."""
    c = len(s)
    k = c + 42
    step = np.empty(k)
    for j in range(k - 1, -1, -1):
        total = S[j, k]
        for i in range(j + 1, k):
            total -= S[j, i] * step[i]
        step[j] = total / S[j, j]
        S[j, k] = 0.0
    for j in range(c):
        s[j] += step[j]
    for j in range(42):
        p[j] += step[c + j]


@njit(cache=True)
def add_pose_to_estimate(
    pose: Pose, machine: Machine, estimate: Estimate, slot: int, innovation: Floats, move: bool
) -> int:
    """Add one pose to the estimate, in place. Returns REFUSED where the pose does not close or is not regular;

    pose : Pose; machine : Machine; estimate : Estimate; slot : the onset that begins with this pose
    innovation : (6,) gets the whitened innovation; move : whether the estimate follows at once; otherwise z gathers,
        all poses about one p
    """
    p, s, S, sums = estimate.p, estimate.s, estimate.S, estimate.sums
    c = len(s)
    k = c + 42
    R, t = machine.home[:3, :3].copy(), machine.home[:3, 3].copy()
    if not forward_kinematics_kernel(pose.command, p, R, t):
        return REFUSED
    right, J, motion = np.empty((6, 7 + c)), np.zeros((6, 42)), np.empty((6, 6))
    _frame_motion(R, t, motion)
    right[:, 1 : 1 + c] = pose.common
    right[:, 1 + c :] = motion
    well, struts = whitened_pose_row(R, t, p, Measured(pose.R, pose.t, pose.covariance), machine.variance, right, J)
    if not well:
        return REFUSED
    _begin(S, sums, slot)
    rows = np.zeros((6, S.shape[1]))
    rows[:, :c] = right[:, 1 : 1 + c]
    rows[:, c:k] = J
    for i in range(6):
        rows[i, k] = right[i, 0]
        for j in range(c):
            rows[i, k] -= right[i, 1 + j] * s[j]
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            at = k + 1 + KINDS * w
            rows[:, at : at + 6] = struts
            rows[:, at + 6 : at + 12] = right[:, 1 + c :]
    _absorb(S, rows)
    innovation[:] = rows[:, k]
    _gather(rows, k, sums)
    if move:
        update_estimate(p, s, S)
    return ALARM if _suspicious(sums) else QUIET


@njit(cache=True)
def _begin(S: Floats, sums: Floats, slot: int) -> None:
    """An onset begins in a slot: its KINDS columns of the triangle S (n, n) and its row of the sums (slots, ..) are
    nothing yet.
    """
    at = S.shape[0] + 1 + KINDS * slot
    S[:, at : at + KINDS] = 0.0
    sums[slot] = 0.0
    sums[slot, -1] = 1e-9  # begun


@njit(cache=True)
def _gather(rows: Floats, k: int, sums: Floats) -> None:
    """Add to every onset's sums (WINDOW, SUMS) what a pose's rows (6, w) tell of it: the innovation is their column
    k.
    """
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            at = k + 1 + KINDS * w
            for i in range(6):
                nu = rows[i, k]
                sums[w, 0] += nu * nu
                for a in range(KINDS):
                    sums[w, 1 + a] += rows[i, at + a] * nu
                    for b in range(KINDS):
                        sums[w, 1 + KINDS + KINDS * a + b] += rows[i, at + a] * rows[i, at + b]
            sums[w, -1] += 1.0


@njit(cache=True)
def _suspicious(sums: Floats) -> bool:
    """Whether any onset's sums (WINDOW, SUMS) leave room for a change."""
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            if sums[w, 0] > LEAST:
                return True
            for a in range(6):
                if sums[w, 1 + a] ** 2 > JUMP**2 * sums[w, 1 + KINDS + (KINDS + 1) * a]:
                    return True
    return False
