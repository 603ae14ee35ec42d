"""Mechanism whose kinematics its owner states in a file.

Forward by Newton or the file's own, Jacobians, limits.

The axes follow from the pose by the file's inverse; all else is derived from that, by derivatives of it. A platform of
fewer than six freedoms keeps its other coordinates as at home, or as the file's forward gives them; the inverse
is asked for the nearest pose that it can take.
"""

from dataclasses import replace
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged, Unreachable
from rig.model.checked_loading_of_user_kinematics_file import (
    load_checked_kinematics_source,
    poses_with_locked_coordinates_at_home,
)
from rig.model.mechanism_geometry_classes import FileMechanism
from rig.model.mechanisms.hexapod_newton_and_least_squares_forward_solution import Observe
from rig.model.user_kinematics_file import KinematicsFile
from rig.model.user_kinematics_file_derivatives import axis_change_columns_by_freedom, axis_change_columns_by_parameter

AXIS, UNIT = "axis", "m"
SCALE = 5e-4  # m that a parameter's tolerance counts as, so that lengths and angles share one scale
TOLERANCE, GOOD = 1e-13, 1e-10  # m or rad of an axis; what Newton seeks, and what counts as solved
MAX_ITERATIONS = 40
CONTRACTS = 0.3  # share of its error that a step leaves at the most for derivatives to stay as they are
MAX_MOVE, MAX_TURN = 0.2, 0.4  # of the distance of home from the base's origin; rad, per step
LEAST_REACH = 0.05  # m, which that distance counts as at least


def nominal_mechanism_of_kinematics_file(file: str, source: str) -> FileMechanism:
    """The nominal mechanism of a kinematics file.

    Raises FileError for a file that cannot be used.
    """
    return FileMechanism(file, source, load_checked_kinematics_source(source, file).nominal)


def inverse(T_base_platform: RigidTransform, mechanism: FileMechanism) -> Floats:
    """Inverse kinematics: axis values (..., axes) m or rad of the poses nearest to poses (...) that can be taken.

    Raises Unreachable with the index of poses for which the file has no values
    """
    poses = poses_with_locked_coordinates_at_home(mechanism.stated, T_base_platform.as_matrix().reshape(-1, 4, 4))
    values = mechanism.stated.inverse(poses, mechanism.parameters).astype(float)
    failed = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(failed):
        raise Unreachable(
            f"{mechanism.file}: inverse gives no axis values for {len(failed)} of {len(values)} poses:",
            failed,
            [f"pose {i}: {values[i].tolist()} at {poses[i, :3, 3].round(6).tolist()} m" for i in failed.tolist()],
        )
    return values.reshape(*T_base_platform.shape, -1)


def forward(values: Floats, mechanism: FileMechanism, guess: RigidTransform | None = None) -> RigidTransform:
    """Forward kinematics: T_base_platform (...) of axis values (..., axes), by the file's forward or by Newton.

    guess : RigidTransform () or (...), the home pose by default; unused where the file has a forward
    Raises NotConverged with index, values and residual of those that have no pose near the guess, or beyond a
    singularity; ValueError for a wrong shape or values that are not finite
    """
    values = np.asarray(values, float)
    n = len(mechanism.stated.axes)
    if values.shape[-1:] != (n,) or not np.isfinite(values).all():
        raise ValueError(f"expected finite axis values (..., {n}) m or rad, got shape {values.shape}")
    flat = values.reshape(-1, n)
    if mechanism.stated.has_forward:
        poses = mechanism.stated.forward(flat, mechanism.parameters).astype(float)
        left = np.where(np.isfinite(poses).all(axis=(1, 2)), 0.0, np.inf)
        _require_solved(left, flat, mechanism)
        return RigidTransform.from_matrix(poses.reshape(*values.shape[:-1], 4, 4))
    start = mechanism.stated.home if guess is None else guess.as_matrix()
    if start.ndim > 2:
        start = np.broadcast_to(start, (*values.shape[:-1], 4, 4))
    poses = np.array(np.broadcast_to(start.reshape(-1, 4, 4), (len(flat), 4, 4)))
    poses = solve_poses_by_newton_with_file_inverse(poses, flat, mechanism)
    return RigidTransform.from_matrix(poses.reshape(*values.shape[:-1], 4, 4))


def solve_poses_by_newton_with_file_inverse(
    start: Floats, values: Floats, mechanism: FileMechanism, observe: Observe | None = None
) -> Floats:
    """Solve poses (n, 4, 4) of axis values (n, axes) by Newton with the file's inverse alone.

    From a start (n, 4, 4).
    observe : called with each step's (poses (n, 4, 4), change of the axes with the freedoms (n, axes, freedoms), error
        (n, axes), step (n, freedoms)), or None
    Raises NotConverged as `forward`
    """
    poses = poses_with_locked_coordinates_at_home(mechanism.stated, start)
    columns = _columns_at_starts(poses, mechanism)
    before = _side(columns)
    left = _newton(poses, values, columns, mechanism, observe)
    after = _side(axis_change_columns_by_freedom(mechanism.stated, poses, mechanism.parameters))
    left[(left < GOOD) & (after != before)] = np.inf
    _require_solved(left, values, mechanism)
    return poses


def _columns_at_starts(poses: Floats, mechanism: FileMechanism) -> Floats:
    """(n, axes, freedoms) change of the axes with the freedoms at poses (n, 4, 4); once where all are the same."""
    one = len(poses) > 1 and not np.ptp(poses, axis=0).any()
    columns = axis_change_columns_by_freedom(mechanism.stated, poses[:1] if one else poses, mechanism.parameters)
    return np.array(np.broadcast_to(columns, (len(poses), *columns.shape[1:])))


def _newton(
    poses: Floats, values: Floats, columns: Floats, mechanism: FileMechanism, observe: Observe | None
) -> Floats:
    """Move poses (n, 4, 4) in place until their axis values are those wanted (n, axes); what is left (n,) m or rad.

    columns : (n, axes, freedoms) change of the axes with the freedoms at these poses; made anew, in place, for a pose
        whose error a step has not made much smaller, since derivatives cost most
    A step to where the file has no values is halved
    """
    file, left, going = mechanism.stated, np.full(len(poses), np.inf), np.arange(len(poses))
    start, step = poses.copy(), np.zeros((len(poses), len(file.freedoms)))
    for _ in range(MAX_ITERATIONS):
        error = values[going] - file.inverse(poses[going], mechanism.parameters).astype(float)
        worst = np.abs(error).max(axis=1)
        finite, slow = np.isfinite(worst), ~(worst < CONTRACTS * left[going])
        keep = ~finite | ((worst > TOLERANCE) & ((worst < left[going]) | (worst > GOOD)))
        left[going[finite]] = worst[finite]
        going, error, finite, slow = going[keep], error[keep], finite[keep], slow[keep]
        if not len(going):
            break
        step[going[~finite]] /= 2
        fresh = going[finite]
        start[fresh] = poses[fresh]
        renewed = going[finite & slow]
        if len(renewed):
            columns[renewed] = axis_change_columns_by_freedom(file, poses[renewed], mechanism.parameters)
        step[fresh] = _step(columns[fresh], error[finite], file)
        if observe is not None:
            observe(start[going], columns[going], error, step[going])
        poses[going] = _moved(start[going], step[going], file)
    return left


def _step(columns: Floats, error: Floats, file: KinematicsFile) -> Floats:
    """(n, freedoms) m or rad by which to move poses so that their axis values change by (n, axes), bounded in length;
    0 where their change (n, axes, freedoms) is unknown.
    """
    reach = MAX_MOVE * max(float(np.linalg.norm(file.home[:3, 3])), LEAST_REACH)
    J = np.where(np.isfinite(columns).all(axis=(1, 2), keepdims=True), columns, 0.0)
    step = (np.linalg.pinv(J) @ error[..., None])[..., 0]
    moves = np.array(file.freedoms) < 3
    move, turn = np.linalg.norm(step[:, moves], axis=1), np.linalg.norm(step[:, ~moves], axis=1)
    return np.asarray(step / np.maximum(1.0, np.maximum(move / reach, turn / MAX_TURN))[:, None])


def _moved(poses: Floats, step: Floats, file: KinematicsFile) -> Floats:
    """Poses (n, 4, 4) moved along and turned about the base's axes by steps (n, freedoms)."""
    base, out = np.zeros((len(step), 6)), poses.copy()
    base[:, file.freedoms] = step
    out[:, :3, 3] += base[:, :3]
    out[:, :3, :3] = Rotation.from_rotvec(base[:, 3:]).as_matrix() @ poses[:, :3, :3]
    return out


def _side(columns: Floats) -> Floats:
    """(n,) sign of the determinant of the axes' change with the freedoms (n, axes, freedoms): of which assembly poses
    are.
    """
    return np.sign(np.linalg.det(np.nan_to_num(columns)))


def _require_solved(left: Floats, values: Floats, mechanism: FileMechanism) -> None:
    """Raise NotConverged for axis values (n, axes) that leave more (n,) m or rad than counts as solved."""
    failed = np.flatnonzero(~(left < GOOD))
    if len(failed):
        k = failed[np.argmax(left[failed])]
        raise NotConverged(
            f"{mechanism.file}: {len(failed)} of {len(left)} axis values have no pose near home in its assembly; first "
            f"{values[k].round(6).tolist()}",
            failed,
            values[failed],
            left[failed],
        )


def nearest_reachable_poses_of_kinematics_file(
    T_base_platform: RigidTransform, mechanism: FileMechanism
) -> RigidTransform:
    """Nearest poses (...) that the platform of a kinematics file can reach.

    The nearest that the platform can take.
    """
    matrices = T_base_platform.as_matrix()
    return RigidTransform.from_matrix(
        poses_with_locked_coordinates_at_home(mechanism.stated, matrices.reshape(-1, 4, 4)).reshape(matrices.shape)
    )


def _free_directions(poses: Floats, mechanism: FileMechanism) -> Floats:
    """(n, 6, freedoms) tangents on the right of unit moves along and about the base's axes, orthonormal."""
    freedoms = mechanism.stated.freedoms
    out = np.zeros((len(poses), 6, len(freedoms)))
    for k, freedom in enumerate(freedoms):
        part = slice(0, 3) if freedom < 3 else slice(3, 6)
        out[:, part, k] = poses[:, freedom % 3, :3]
    return out


def jacobian(T_base_platform: RigidTransform, mechanism: FileMechanism) -> Floats:
    """Jacobian (..., axes, 6) of the axis values with the pose's tangent on the right.

    0 along what is no freedom.
    """
    poses = poses_with_locked_coordinates_at_home(mechanism.stated, T_base_platform.as_matrix().reshape(-1, 4, 4))
    columns = axis_change_columns_by_freedom(mechanism.stated, poses, mechanism.parameters)
    out = columns @ np.swapaxes(_free_directions(poses, mechanism), 1, 2)
    return cast(Floats, out.reshape(*T_base_platform.shape, *out.shape[1:]))


def fitted_parameter_indices(mechanism: FileMechanism) -> Integers:
    """Indices (k,) of the parameters that a calibration fits.

    Their tolerance is not 0.
    """
    return np.flatnonzero(mechanism.stated.tolerances)


def scaled_parameters(mechanism: FileMechanism) -> Floats:
    """Scaled parameters (k,) m of a mechanism.

    The identified parameters less the owner's in tolerances, each of which counts as SCALE.
    """
    free, stated = fitted_parameter_indices(mechanism), mechanism.stated
    return SCALE * (mechanism.parameters - stated.nominal)[free] / stated.tolerances[free]


def with_scaled_parameters(mechanism: FileMechanism, scaled: Floats) -> FileMechanism:
    """The mechanism with scaled parameters (k,) m."""
    free, p = fitted_parameter_indices(mechanism), mechanism.stated.nominal.copy()
    p[free] += scaled / SCALE * mechanism.stated.tolerances[free]
    held = np.setdiff1d(np.arange(len(p)), free)
    p[held] = mechanism.parameters[held]
    return FileMechanism(mechanism.file, mechanism.source, p)


def with_random_parameters(mechanism: FileMechanism, rng: np.random.Generator, size: float) -> FileMechanism:
    """The mechanism with parameters drawn at random about its own.

    Standard deviation `size` of their tolerances.
    """
    tolerances = mechanism.stated.tolerances
    return replace(mechanism, parameters=mechanism.parameters + size * tolerances * rng.normal(size=len(tolerances)))


def loop_closure_parameter_jacobian(T_base_platform: RigidTransform, mechanism: FileMechanism) -> Floats:
    """Jacobian (..., axes, k) of the loop closure by the scaled parameters, at poses (...).

    It is that of minus the axis values.
    """
    poses = poses_with_locked_coordinates_at_home(mechanism.stated, T_base_platform.as_matrix().reshape(-1, 4, 4))
    free = fitted_parameter_indices(mechanism)
    out = -axis_change_columns_by_parameter(mechanism.stated, poses, mechanism.parameters, free)
    out *= mechanism.stated.tolerances[free] / SCALE
    return out.reshape(*T_base_platform.shape, *out.shape[1:])


def parameter_units_and_scales(mechanism: FileMechanism) -> tuple[tuple[str, ...], Floats]:
    """Units and scales of the identified parameters.

    Returns (units; (k,) unit of it for each m of the scaled parameters)
    """
    free, stated = fitted_parameter_indices(mechanism), mechanism.stated
    return tuple(stated.units[k] for k in free), stated.tolerances[free] / SCALE


def parameter_names(mechanism: FileMechanism) -> tuple[str, ...]:
    """Names of the parameters that are fitted, of all that the file states, in order."""
    names = mechanism.stated.names
    return tuple(names[k] for k in fitted_parameter_indices(mechanism))


def signed_limit_excess(values: Floats, mechanism: FileMechanism) -> Floats:
    """Excess (..., axes) of commanded values over their travel.

    Negative below, positive above, 0 inside.
    """
    low, high = travel_ranges(mechanism).T
    return np.minimum(values - low, 0) + np.maximum(values - high, 0)


def travel_ranges(mechanism: FileMechanism) -> Floats:
    """Travel (axes, 2) m or rad of the axes."""
    return np.array([[axis.low, axis.high] for axis in mechanism.stated.axes])


def home_values(mechanism: FileMechanism) -> Floats:
    """Home values (axes,) m or rad: of the home pose."""
    return inverse(mechanism.home_pose, mechanism)


def axis_forces_and_torques(T: RigidTransform, values: Floats, mechanism: FileMechanism, wrench: Floats) -> Floats:
    """Axis forces and torques (n, axes) N or N m that hold a wrench.

    A wrench (n, 6) on the platform. Guides take the rest.
    """
    return -np.einsum("nij,ni->nj", np.linalg.pinv(jacobian(T, mechanism)), wrench)


def link_weight_loads(T: RigidTransform, values: Floats, mechanism: FileMechanism, gravity: Floats) -> Floats:
    """Loads of the links' own weight.

    None (n, axes, 0), the file states no masses.
    """
    return np.zeros((*np.shape(values), 0))


def axis_deviation_and_sway_by_member_growth(
    T: RigidTransform, values: Floats, mechanism: FileMechanism, share: Floats
) -> tuple[Floats, Floats]:
    """Axis deviation (n, axes) and sway (n, 6) by growth of members, which are slides.

    They grow by shares (n, axes); joints do not.
    """
    slides = np.array([axis.unit == "m" for axis in mechanism.stated.axes])
    return share * values * slides, np.zeros((len(share), 6))


def inverse_kinematics_jacobian(T: RigidTransform, values: Floats, mechanism: FileMechanism) -> Floats:
    """Jacobian (n, axes, 6) of inverse kinematics.

    Change of the axis values with the pose's tangent at T (n,).
    """
    return jacobian(T, mechanism)


def jacobian_rows_by_axis(T: RigidTransform, values: Floats, mechanism: FileMechanism) -> Floats:
    """Rows (n, axes, 6) of the Jacobian, one for each axis, at poses T (n,)."""
    return jacobian(T, mechanism)


def link_points(values: Floats, mechanism: FileMechanism) -> None:
    """None for any values (n, axes): a kinematics file states no links to draw."""
    return None


def strut_ends(T: RigidTransform, mechanism: FileMechanism) -> None:
    """None: a kinematics file states no strut ends."""
    return None
