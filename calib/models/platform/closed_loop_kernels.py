"""The hexapod's error model, compiled: delta_e = J_p delta_x from the closed vector loops, at the pose that the
parameters predict.

Each strut closes a loop: commanded length + zero = |R a + t - b|. At constant command a change of the 42 parameters
moves the pose by J_p = A^-1 D, where A is the struts' Jacobian to the pose and D the loops' to the parameters. Taking
both at the predicted pose, not at the measured one, keeps the measured pose's noise out of them. Source: Masory, Wang
and Zhuang, On the accuracy of a Stewart platform, ICRA 1993; the on-line learning patent for Stewart platforms, eq. 1
[0024].
"""

from typing import NamedTuple

import numpy as np

from rig.compute.numba_kernels import njit
from rig.model.rotation_increment import rotate_increment

TOLERANCE = 1e-13  # m; what Newton leaves of a strut's length
MAX_ITERATIONS = 40
MAX_TURN = 0.4  # rad per step, so that Newton stays in its assembly


class Measured(NamedTuple):
    """A measured pose, or n of them: R (..., 3, 3); t (..., 3) m; covariance (..., 6, 6) m^2, m rad, rad^2, tangent on
    the right.
    """

    R: np.ndarray
    t: np.ndarray
    covariance: np.ndarray


@njit(cache=True)
def solve_in_place(A: np.ndarray, B: np.ndarray) -> bool:
    """Gaussian elimination with row pivots: B (n, k) becomes A^-1 B, A (n, n) is used up. Returns whether A is
    regular.
    """
    n, width = A.shape[0], B.shape[1]
    for j in range(n):
        pivot = j
        for i in range(j + 1, n):
            if abs(A[i, j]) > abs(A[pivot, j]):
                pivot = i
        if abs(A[pivot, j]) < 1e-12:
            return False
        if pivot != j:
            for k in range(n):
                A[j, k], A[pivot, k] = A[pivot, k], A[j, k]
            for k in range(width):
                B[j, k], B[pivot, k] = B[pivot, k], B[j, k]
        for i in range(n):
            if i != j:
                f = A[i, j] / A[j, j]
                if f != 0.0:
                    for k in range(j, n):
                        A[i, k] -= f * A[j, k]
                    for k in range(width):
                        B[i, k] -= f * B[j, k]
    for j in range(n):
        for k in range(width):
            B[j, k] /= A[j, j]
    return True


@njit(cache=True)
def cholesky_in_place(C: np.ndarray) -> bool:
    """Lower triangle L of C = L L^T (n, n), in C's own. Returns whether C is positive definite."""
    n = C.shape[0]
    for j in range(n):
        for i in range(j, n):
            total = C[i, j]
            for k in range(j):
                total -= C[i, k] * C[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                C[j, j] = np.sqrt(total)
            else:
                C[i, j] = total / C[j, j]
    return True


@njit(cache=True)
def forward_in_place(L: np.ndarray, B: np.ndarray) -> None:
    """B (n, k) becomes L^-1 B, with the lower triangle of L (n, n)."""
    n, width = L.shape[0], B.shape[1]
    for i in range(n):
        for k in range(width):
            total = B[i, k]
            for j in range(i):
                total -= L[i, j] * B[j, k]
            B[i, k] = total / L[i, i]


@njit(cache=True)
def struts(R: np.ndarray, t: np.ndarray, p: np.ndarray, length: np.ndarray, u: np.ndarray, A: np.ndarray) -> None:
    """Into length (6,), unit directions u (6, 3) in the base and A (6, 6): the struts at pose R, t for parameters p
    (42,).
    """
    for i in range(6):
        a = p[18 + 3 * i : 21 + 3 * i]
        for k in range(3):
            u[i, k] = R[k, 0] * a[0] + R[k, 1] * a[1] + R[k, 2] * a[2] + t[k] - p[3 * i + k]
        length[i] = np.sqrt(u[i, 0] ** 2 + u[i, 1] ** 2 + u[i, 2] ** 2)
        for k in range(3):
            u[i, k] /= length[i]
        for k in range(3):
            A[i, k] = u[i, 0] * R[0, k] + u[i, 1] * R[1, k] + u[i, 2] * R[2, k]
        A[i, 3] = a[1] * A[i, 2] - a[2] * A[i, 1]
        A[i, 4] = a[2] * A[i, 0] - a[0] * A[i, 2]
        A[i, 5] = a[0] * A[i, 1] - a[1] * A[i, 0]


@njit(cache=True)
def pose_of(command: np.ndarray, p: np.ndarray, R: np.ndarray, t: np.ndarray) -> bool:
    """Newton from pose R (3, 3), t (3,), moved in place, to the pose of a command (6,) m. Returns whether it got
    there.
    """
    length, u, A, right = np.empty(6), np.empty((6, 3)), np.empty((6, 6)), np.empty((6, 1))
    reach = 0.3 * np.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2) + 1e-3
    worst = np.inf
    for _ in range(MAX_ITERATIONS):
        struts(R, t, p, length, u, A)
        before, worst = worst, 0.0
        for i in range(6):
            right[i, 0] = command[i] + p[36 + i] - length[i]
            worst = max(worst, abs(right[i, 0]))
        if worst < TOLERANCE or (worst < 1e-12 and worst >= before):
            return True
        if not solve_in_place(A, right):
            return False
        move = np.sqrt(right[0, 0] ** 2 + right[1, 0] ** 2 + right[2, 0] ** 2)
        turn = np.sqrt(right[3, 0] ** 2 + right[4, 0] ** 2 + right[5, 0] ** 2)
        share = 1 / max(1.0, max(turn / MAX_TURN, move / reach))
        for i in range(3):
            t[i] += share * (R[i, 0] * right[0, 0] + R[i, 1] * right[1, 0] + R[i, 2] * right[2, 0])
        for i in range(3, 6):
            right[i, 0] *= share
        rotate_increment(R, right[3:, 0])
    return worst < 1e-11


@njit(cache=True)
def error(R: np.ndarray, t: np.ndarray, R_measured: np.ndarray, t_measured: np.ndarray, e: np.ndarray) -> None:
    """Into e (6,): position (m) and rotation vector (rad) of the measured pose seen in the predicted one."""
    M = np.empty((3, 3))
    for i in range(3):
        e[i] = 0.0
        for k in range(3):
            e[i] += R[k, i] * (t_measured[k] - t[k])
            M[i, k] = R[0, i] * R_measured[0, k] + R[1, i] * R_measured[1, k] + R[2, i] * R_measured[2, k]
    x, y, z = (M[2, 1] - M[1, 2]) / 2, (M[0, 2] - M[2, 0]) / 2, (M[1, 0] - M[0, 1]) / 2
    sine, cosine = np.sqrt(x * x + y * y + z * z), (M[0, 0] + M[1, 1] + M[2, 2] - 1) / 2
    grow = np.arctan2(sine, cosine) / sine if sine > 1e-9 else 1.0
    e[3], e[4], e[5] = x * grow, y * grow, z * grow


@njit(cache=True)
def row(
    R: np.ndarray,
    t: np.ndarray,
    p: np.ndarray,
    measured: Measured,
    scatter: np.ndarray,
    right: np.ndarray,
    J: np.ndarray,
) -> tuple[bool, np.ndarray]:
    """One pose's whitened rows, docs/mathematics.md (7): right (6, 1 + k), whose columns from the second are given in
    the pose's tangent, gets the error as its first and is whitened in place; J (6, 42) and the struts' own columns S
    (6, 6), returned, likewise.

    R, t : the predicted pose; p : (42,) m; measured : Measured, of one pose; scatter : (6,) m^2 variance of each strut
        beyond its covariance
    Returns (well, S): whether all is regular
    """
    length, u, A = np.empty(6), np.empty((6, 3)), np.empty((6, 6))
    struts(R, t, p, length, u, A)
    turned, inverse = A[:, :3].copy(), np.zeros((6, 6))
    for i in range(6):
        inverse[i, i] = 1.0
    if not solve_in_place(A, inverse):
        return False, inverse
    C = measured.covariance.copy()
    for i in range(6):
        for j in range(6):
            for k in range(6):
                C[i, j] += inverse[i, k] * scatter[k] * inverse[j, k]
    if not cholesky_in_place(C):
        return False, inverse
    error(R, t, measured.R, measured.t, right[:, 0])
    forward_in_place(C, right)
    forward_in_place(C, inverse)
    for i in range(6):
        for r in range(6):
            g = inverse[r, i]
            for k in range(3):
                J[r, 3 * i + k] = g * u[i, k]
                J[r, 18 + 3 * i + k] = -g * turned[i, k]
            J[r, 36 + i] = g
    return True, inverse


@njit(cache=True)
def rows(
    commands: np.ndarray,
    R: np.ndarray,
    t: np.ndarray,
    p: np.ndarray,
    measured: Measured,
    scatter: np.ndarray,
    right: np.ndarray,
    J: np.ndarray,
) -> int:
    """All poses' whitened rows, as `row` has them: right (n, 6, 1 + k), J (n, 6, 42); R, t (n, ..) start near the
    predicted poses and become them.

    commands : (n, 6) m; measured : Measured, of n poses. Returns the first pose that has no solution or no covariance,
        or -1
    """
    for i in range(len(commands)):
        one = Measured(measured.R[i], measured.t[i], measured.covariance[i])
        if not pose_of(commands[i], p, R[i], t[i]) or not row(R[i], t[i], p, one, scatter, right[i], J[i])[0]:
            return i
    return -1
