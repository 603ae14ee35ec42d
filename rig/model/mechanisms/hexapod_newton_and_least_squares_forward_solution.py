"""Newton and least-squares forward solution of hexapods.

Where the compiled steps do not lead, or struts are more.
Each step may be observed, so that a solution can be followed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged
from rig.model.mechanism_geometry_classes import Hexapod

Observe = Callable[[Floats, Floats, Floats, Floats], None]  # poses, matrix, what is left, step; of each iteration
TOLERANCE = 1e-12  # m; what Newton leaves of a strut's length
MAX_ITERATIONS = 60
MAX_TURN = 0.4  # rad per step: keeps Newton from jumping into another assembly
LOOSE = (
    1e-9  # of the Jacobian's largest singular value, in m and rad: below, more than six struts leave a platform loose
)


def strut_lengths_and_jacobian(R: Floats, t: Floats, hexapod: Hexapod) -> tuple[Floats, Floats]:
    """Strut lengths (..., struts) and their Jacobian (..., struts, 6) at rotation R (..., 3, 3), place t (..., 3)."""
    struts = hexapod.platform_joints @ np.swapaxes(R, -1, -2) + t[..., None, :] - hexapod.base_joints
    length = np.sqrt(np.einsum("...ij,...ij->...i", struts, struts))
    u = (struts / length[..., None]) @ R  # unit directions, platform frame
    a = hexapod.platform_joints
    J = np.empty((*u.shape[:-1], 6))
    J[..., :3] = u
    J[..., 3] = a[:, 1] * u[..., 2] - a[:, 2] * u[..., 1]
    J[..., 4] = a[:, 2] * u[..., 0] - a[:, 0] * u[..., 2]
    J[..., 5] = a[:, 0] * u[..., 1] - a[:, 1] * u[..., 0]
    return length, J


def solve_poses_in_place_by_pivoted_newton(
    matrix: Floats, lengths: Floats, hexapod: Hexapod, observe: Observe | None = None
) -> Floats:
    """Solve poses, matrix (n, 4, 4), in place by Newton for strut lengths (n, 6).

    Each solve pivots; lengths include the zeros.
    observe : called with each step's (matrix (n, 4, 4), Jacobian (n, 6, 6), error (n, 6), step (n, 6)), or None
    Returns the residual (n,) m
    """
    residual = np.full(len(matrix), np.inf)
    open_ = np.arange(len(matrix))
    for _ in range(MAX_ITERATIONS):
        length, J = strut_lengths_and_jacobian(matrix[open_, :3, :3], matrix[open_, :3, 3], hexapod)
        error = lengths[open_] - length
        worst = np.abs(error).max(axis=1)
        residual[open_] = worst
        going = worst > TOLERANCE
        if not going.any():
            break
        if not going.all():
            open_, J, error = open_[going], J[going], error[going]
        try:
            step = np.linalg.solve(J, error[..., None])[..., 0]
        except np.linalg.LinAlgError:
            step = (np.linalg.pinv(J) @ error[..., None])[..., 0]
        _move_by_limited_steps(matrix, open_, J, error, cast(Floats, step), hexapod, observe)
    return residual


def poses_of_redundant_lengths_by_gauss_newton(
    commanded: Floats, lengths: Floats, guess: RigidTransform, hexapod: Hexapod, observe: Observe | None = None
) -> Floats:
    """Poses (n, 4, 4) of the lengths (n, struts) m of redundant struts, by Gauss-Newton.

    More than six struts of one stiffness balance there: the steps' projection on the pose vanishes. commanded : (...,
    struts) m, for messages
    observe : as of `solve_poses_in_place_by_pivoted_newton`
    Raises NotConverged for lengths that hold no pose near the guess
    """
    matrix = np.array(np.broadcast_to(guess.as_matrix(), (*commanded.shape[:-1], 4, 4)).reshape(-1, 4, 4))
    left, going = np.full(len(matrix), np.inf), np.arange(len(matrix))
    size = np.linalg.norm(hexapod.platform_joints, axis=1).max()
    for _ in range(MAX_ITERATIONS):
        length, J = strut_lengths_and_jacobian(matrix[going, :3, :3], matrix[going, :3, 3], hexapod)
        error = lengths[going] - length
        step = (np.linalg.pinv(J, rcond=LOOSE) @ error[..., None])[..., 0]
        move, turn = _sizes(step)
        left[going] = np.maximum(move, size * turn)
        _move_by_limited_steps(matrix, going, J, error, step, hexapod, observe)
        going = going[left[going] > TOLERANCE]
        if not len(going):
            break
    values = np.linalg.svd(
        strut_lengths_and_jacobian(matrix[:, :3, :3], matrix[:, :3, 3], hexapod)[1], compute_uv=False
    )
    failed = np.flatnonzero(~(left <= 10 * TOLERANCE) | (values[:, -1] < LOOSE * values[:, 0]))
    if len(failed):
        flat = commanded.reshape(-1, commanded.shape[-1])
        raise NotConverged(
            f"{len(failed)} of {len(left)} poses are not held by the struts near the guess; first at lengths "
            f"{flat[failed[0]].round(6).tolist()} m",
            failed,
            flat[failed],
            left[failed],
        )
    return matrix


def _sizes(step: Floats) -> tuple[Floats, Floats]:
    """(m, rad) (n,) each, of steps (n, 6)."""
    return np.linalg.norm(step[:, :3], axis=1), np.linalg.norm(step[:, 3:], axis=1)


def _move_by_limited_steps(
    matrix: Floats, rows: Integers, J: Floats, error: Floats, step: Floats, hexapod: Hexapod, observe: Observe | None
) -> None:
    """Move the rows (k,) of matrix (n, 4, 4) in place by steps (k, 6), of which long ones are shortened."""
    move, turn = _sizes(step)
    reach = 0.3 * np.linalg.norm(hexapod.home.translation)
    step /= np.maximum(1.0, np.maximum(turn / MAX_TURN, move / reach))[:, None]
    if observe is not None:
        observe(matrix[rows], J, error, step)
    R = matrix[rows, :3, :3]
    matrix[rows, :3, 3] += (R @ step[:, :3, None])[..., 0]
    matrix[rows, :3, :3] = R @ Rotation.from_rotvec(step[:, 3:]).as_matrix()


def require_converged_forward_solution(
    matrix: Floats, start: Floats, residual: Floats, lengths: Floats, hexapod: Hexapod, doubtful: Integers
) -> None:
    """Raise NotConverged for poses (n, 4, 4) to which a forward solution did not converge.

    Or, of those doubtful (k,), for those solved beyond a singularity.
    """
    failed = np.flatnonzero(residual > 10 * TOLERANCE)
    if len(failed):
        worst = failed[np.argmax(residual[failed])]
        raise NotConverged(
            f"{len(failed)} of {len(residual)} poses have no solution near the guess; worst leaves "
            f"{residual[worst]:.3g} m "
            f"at lengths {lengths.reshape(-1, 6)[worst].round(6).tolist()} m",
            failed,
            lengths.reshape(-1, 6)[failed],
            residual[failed],
        )
    side, before = (
        np.linalg.det(strut_lengths_and_jacobian(part[:, :3, :3], part[:, :3, 3], hexapod)[1])
        for part in (matrix[doubtful], start[doubtful])
    )
    crossed = doubtful[np.sign(side) != np.sign(before)]
    if len(crossed):
        raise NotConverged(
            f"{len(crossed)} of {len(residual)} poses were found only beyond a singularity, in another "
            "assembly; first at "
            f"lengths {lengths.reshape(-1, 6)[crossed[0]].round(6).tolist()} m",
            crossed,
            lengths.reshape(-1, 6)[crossed],
            residual[crossed],
        )
