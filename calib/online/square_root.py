"""One pose into a square-root information filter, compiled: the triangle, the estimate, and what a jump would have looked like.

The state is a triangle [R | z | signatures]: R dp = z about the present estimate, moved so that z is zero. A pose adds six whitened
rows; Householder reflections bring the triangle back, and what they leave in the rows is the whitened innovation. A column of
signatures, carried along, leaves there what a jump since a given pose would add to it, less what the parameters
would have made of it: their inner products are the likelihood ratio of the jump. Source: Bierman, Factorization Methods for
Discrete Sequential Estimation, 1977; Willsky and Jones, IEEE Trans. Automatic Control 21, 1976 (the ratio).
"""

import numpy as np
from numba import njit

from calib.identify.closed_loop import pose_of, row
from calib.online.change_detection import JUMP, MOVED

WINDOW = 3  # poses within which a jump must show
KINDS = 12  # signatures of an onset: six struts, six motions of the measuring frame against the base
REFUSED, QUIET, ALARM = 0, 1, 2  # what `learn` says
LEAST = MOVED[2]  # innovations squared below which no hypothesis of calib/online/change_detection.py but a strut's can hold
SUMS = 1 + KINDS + KINDS * KINDS + 1  # per onset: innovation squared, its products with the signatures, the signatures' own, poses


@njit(cache=True)
def absorb(S, rows):
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
def frame_motion(R, t, out):
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
def follow(p, s, S):
    """The estimate p (42,), s (c,) moves to where the triangle S has it, and z becomes zero."""
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
def learn(command, R_measured, t_measured, covariance, common, scatter, home, p, s, S, sums, slot, innovation, move):
    """One pose into the state, in place. Returns REFUSED where the command closes on no pose near home or something is not regular;
    then nothing changed. Else ALARM where something may have jumped, or QUIET.

    command : (6,) m; covariance : (6, 6); common : (6, c) tangent; scatter : (6,) m^2; home : (4, 4)
    p : (42,) parameters; s : (c,) shared draw; S : (c + 42, c + 43 + KINDS WINDOW) triangle; sums : (WINDOW, SUMS)
    slot : the onset that begins with this pose; innovation : (6,) gets the whitened innovation
    move : whether the estimate follows at once; otherwise z gathers, all poses about the same estimate
    """
    c = len(s)
    k = c + 42
    R, t = home[:3, :3].copy(), home[:3, 3].copy()
    if not pose_of(command, p, R, t):
        return REFUSED
    right, J, motion = np.empty((6, 7 + c)), np.zeros((6, 42)), np.empty((6, 6))
    frame_motion(R, t, motion)
    right[:, 1 : 1 + c] = common
    right[:, 1 + c :] = motion
    well, struts = row(R, t, p, R_measured, t_measured, covariance, scatter, right, J)
    if not well:
        return REFUSED
    S[:, k + 1 + KINDS * slot : k + 1 + KINDS * (slot + 1)] = 0.0
    sums[slot] = 0.0
    sums[slot, -1] = 1e-9  # begun
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
    absorb(S, rows)
    innovation[:] = rows[:, k]
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
    if move:
        follow(p, s, S)
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            if sums[w, 0] > LEAST:
                return ALARM
            for a in range(6):
                if sums[w, 1 + a] ** 2 > JUMP**2 * sums[w, 1 + KINDS + (KINDS + 1) * a]:
                    return ALARM
    return QUIET
