"""Closed-loop equations of struts.

Residuals and Jacobians, compiled for hexapods, and for others.

Each strut closes a loop: commanded length + zero = |R a + t - b|. At constant command a change of the 42 parameters
moves the pose by J_p = A^-1 D, where A is the struts' Jacobian to the pose and D the loops' to the parameters. Taking
both at the predicted pose, not at the measured one, keeps the measured pose's noise out of them. Source: Masory, Wang
and Zhuang, On the accuracy of a Stewart platform, ICRA 1993; the on-line learning patent for Stewart platforms, eq. 1
[0024].

More than six struts close one loop each as well, where their lengths agree with the platform: so they do where the
struts beyond six follow it and say how long they are. Then every loop is an equation.

Of a mechanism of fewer freedoms than six, such as a hinge in a plane, only these are its axes' to give; what was
measured of the other coordinates is no part of the fit.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.identify.bounded_and_robust_least_squares_fit import Linear
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.errors import NotConverged, RigError
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    kinematics_of,
    loop_closure_parameter_jacobian,
    strut_or_axis_jacobian_by_pose,
)
from rig.model.pose import pose_difference, rotate_in_place

TOLERANCE = 1e-13  # m; what Newton leaves of a strut's length
MAX_ITERATIONS = 40
MAX_TURN = 0.4  # rad per step, so that Newton stays in its assembly
READING = 1e-7  # m; the resolution of lengths in commands.csv


class Measured(NamedTuple):
    """A measured pose, or n of them: R (..., 3, 3); t (..., 3) m; covariance (..., 6, 6) m^2, m rad, rad^2, tangent on
    the right.
    """

    R: Floats
    t: Floats
    covariance: Floats


@njit(cache=True)
def _solve_in_place(A: Floats, B: Floats) -> bool:
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
def _cholesky_in_place(C: Floats) -> bool:
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
def _forward_in_place(L: Floats, B: Floats) -> None:
    """B (n, k) becomes L^-1 B, with the lower triangle of L (n, n)."""
    n, width = L.shape[0], B.shape[1]
    for i in range(n):
        for k in range(width):
            total = B[i, k]
            for j in range(i):
                total -= L[i, j] * B[j, k]
            B[i, k] = total / L[i, i]


@njit(cache=True)
def fill_strut_lengths_and_directions(R: Floats, t: Floats, p: Floats, length: Floats, u: Floats, A: Floats) -> None:
    """Fill `length` (6,), `u` (6, 3) and `A` (6, 6) with strut lengths, directions and Jacobian at a pose R, t.

    p : (42,) parameters
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
def solve_pose_in_place_by_newton(command: Floats, p: Floats, R: Floats, t: Floats) -> bool:
    """Solve the pose R (3, 3), t (3,) of a command by Newton, in place.

    Returns whether it converged.
    """
    length, u, A, right = np.empty(6), np.empty((6, 3)), np.empty((6, 6)), np.empty((6, 1))
    reach = 0.3 * np.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2) + 1e-3
    worst = np.inf
    for _ in range(MAX_ITERATIONS):
        fill_strut_lengths_and_directions(R, t, p, length, u, A)
        before, worst = worst, 0.0
        for i in range(6):
            right[i, 0] = command[i] + p[36 + i] - length[i]
            worst = max(worst, abs(right[i, 0]))
        if worst < TOLERANCE or (worst < 1e-12 and worst >= before):
            return True
        if not _solve_in_place(A, right):
            return False
        move = np.sqrt(right[0, 0] ** 2 + right[1, 0] ** 2 + right[2, 0] ** 2)
        turn = np.sqrt(right[3, 0] ** 2 + right[4, 0] ** 2 + right[5, 0] ** 2)
        share = 1 / max(1.0, max(turn / MAX_TURN, move / reach))
        for i in range(3):
            t[i] += share * (R[i, 0] * right[0, 0] + R[i, 1] * right[1, 0] + R[i, 2] * right[2, 0])
        for i in range(3, 6):
            right[i, 0] *= share
        rotate_in_place(R, right[3:, 0])
    return worst < 1e-11


@njit(cache=True)
def fill_pose_error(R: Floats, t: Floats, R_measured: Floats, t_measured: Floats, e: Floats) -> None:
    """Fill `e` (6,) with a pose error.

    Position (m) and rotation vector (rad) of the measured pose in the predicted one.
    """
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
def fill_whitened_pose_row(
    R: Floats, t: Floats, p: Floats, measured: Measured, scatter: Floats, right: Floats, J: Floats
) -> tuple[bool, Floats]:
    """Fill the whitened row of one pose, docs/mathematics.md (7), into `right` and `J`.

    Error, pose and parameter columns.

    R, t : the predicted pose; p : (42,) m; measured : Measured, of one pose; scatter : (6,) m^2 variance of each strut
        beyond its covariance
    Returns (well, S): whether all is regular
    """
    length, u, A = np.empty(6), np.empty((6, 3)), np.empty((6, 6))
    fill_strut_lengths_and_directions(R, t, p, length, u, A)
    turned, inverse = A[:, :3].copy(), np.zeros((6, 6))
    for i in range(6):
        inverse[i, i] = 1.0
    if not _solve_in_place(A, inverse):
        return False, inverse
    C = measured.covariance.copy()
    for i in range(6):
        for j in range(6):
            for k in range(6):
                C[i, j] += inverse[i, k] * scatter[k] * inverse[j, k]
    if not _cholesky_in_place(C):
        return False, inverse
    fill_pose_error(R, t, measured.R, measured.t, right[:, 0])
    _forward_in_place(C, right)
    _forward_in_place(C, inverse)
    for i in range(6):
        for r in range(6):
            g = inverse[r, i]
            for k in range(3):
                J[r, 3 * i + k] = g * u[i, k]
                J[r, 18 + 3 * i + k] = -g * turned[i, k]
            J[r, 36 + i] = g
    return True, inverse


@njit(cache=True)
def fill_whitened_rows_of_all_poses(
    commands: Floats, R: Floats, t: Floats, p: Floats, measured: Measured, scatter: Floats, right: Floats, J: Floats
) -> int:
    """Whitened rows of all poses, as `fill_whitened_pose_row` has them: right (n, 6, 1 + k), J (n, 6, 42).

    commands : (n, 6) m; measured : Measured, of n poses. Returns the first pose that has no solution or no covariance,
        or -1
    """
    for i in range(len(commands)):
        one = Measured(measured.R[i], measured.t[i], measured.covariance[i])
        if (
            not solve_pose_in_place_by_newton(commands[i], p, R[i], t[i])
            or not fill_whitened_pose_row(R[i], t[i], p, one, scatter, right[i], J[i])[0]
        ):
            return i
    return -1


def linearised_loops_of_more_than_six_struts(
    samples: Samples, lengths: Floats, platform: Hexapod, scatter: Floats
) -> Linear:
    """Linearised equations (Linear) of all loops of more than six struts, (n, struts) rows, at a geometry.

    samples : Samples; lengths : (n, struts) m of the struts; scatter : (struts,) m of each beyond the poses' own
    Raises RigError naming the first pose on which the struts do not close
    """
    T = _poses_of_lengths(samples, lengths, platform)
    A = strut_or_axis_jacobian_by_pose(T, platform)
    white = np.linalg.inv(np.linalg.cholesky(loop_covariance(A, samples.covariance) + np.diag(scatter**2)))
    # what the predicted pose leaves of the loops, and from there to the measured one
    left = (A @ pose_difference(T, samples.T_base_platform)[..., None])[..., 0] - (
        lengths - kinematics_of(platform).inverse(T, platform)
    )
    return Linear(
        (white @ left[..., None])[..., 0],
        white @ loop_closure_parameter_jacobian(T, platform),
        white @ A @ samples.common,
    )


def loop_covariance(loop_jacobian: Floats, covariance: Floats) -> Floats:
    """Covariance (n, axes, axes) m^2 that poses' covariance (n, 6, 6) gives loops of a Jacobian (n, axes, 6)."""
    return add_length_resolution_to_loop_covariance(loop_jacobian @ covariance @ np.swapaxes(loop_jacobian, 1, 2))


def add_length_resolution_to_loop_covariance(covariance: Floats) -> Floats:
    """Covariance (n, axes, axes) m^2 of loops with the resolution of lengths added.

    It is how finely lengths are known: READING where more loops than six have combinations that no pose moves, which
    nothing else bounds.
    """
    axes = covariance.shape[1]
    return covariance + READING**2 * np.eye(axes) if axes > 6 else covariance


def scatter_of_redundant_struts(loop_residuals: Floats, strut_jacobian: Floats, fitted_pose_count: int) -> Floats:
    """Scatter (struts,) m of redundant struts, more than six.

    It is alike for all, by the combinations of loops that no pose moves.
    loop_residuals : (n, struts) m, what loops leave at a fit; strut_jacobian : (n, struts, 6) the struts' Jacobian;
    fitted_pose_count : how many poses' worth of parameters were fitted
    """
    free = np.linalg.svd(strut_jacobian)[0][:, :, 6:]
    square = (np.einsum("nij,ni->nj", free, loop_residuals) ** 2).mean() / max(
        1 - fitted_pose_count / len(loop_residuals), 0.1
    )
    return np.full(loop_residuals.shape[1], np.sqrt(max(float(square) - READING**2, 0.0)))


def _poses_of_lengths(samples: Samples, lengths: Floats, mechanism: Parallel) -> RigidTransform:
    """Poses (n,) of lengths or axis values (n, axes). Raises RigError naming the first that close on none."""
    try:
        return kinematics_of(mechanism).forward(lengths, mechanism)
    except NotConverged as error:
        i = int(error.index[0])
        raise RigError(
            f"frame {samples.frame[i]}: the commanded values {lengths[i].round(6).tolist()} close on no pose"
        ) from None


def linearised_pose_coordinate_equations(
    samples: Samples, lengths: Floats, mechanism: Parallel, scatter: Floats
) -> Linear:
    """Linearised equations (Linear) of measured poses in the pose coordinates that the mechanism moves.

    samples : Samples, in these freedoms alone; lengths : (n, axes) m or rad, commanded; scatter : (axes,) of each axis
    beyond the poses' own
    Raises RigError naming the first pose on which the axes do not close
    """
    some = list(mechanism.pose_coordinates)
    T = _poses_of_lengths(samples, lengths, mechanism)
    to_pose = np.linalg.inv(strut_or_axis_jacobian_by_pose(T, mechanism)[..., some])
    own = samples.covariance[:, some][:, :, some] + (to_pose * scatter**2) @ np.swapaxes(to_pose, 1, 2)
    white = np.linalg.inv(np.linalg.cholesky(own))
    left = pose_difference(T, samples.T_base_platform)[:, some]
    return Linear(
        (white @ left[..., None])[..., 0],
        white @ to_pose @ loop_closure_parameter_jacobian(T, mechanism),
        white @ samples.common[:, some],
    )
