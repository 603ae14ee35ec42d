"""Corner Jacobians, normal equations of an adjustment, and their Schur complement.

Derivatives of predicted corners.

In blocks: each frame's unknowns, the shared ones, the cross terms; with the compiled kernels that whiten and sum them.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.compute.parallel_map_and_dask_cluster import thread_map
from vision import opencv_lens_model as lens
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    POSE_SCALE,
    SIDE,
    Estimate,
    Unknowns,
    estimated_marker_motions_by_target_motions,
    printing_error_jacobian,
)
from vision.corner_observations_and_merging import Observations, Whitener
from vision.marker_corner_prediction import (
    State,
    base_points_in_camera_frame,
    iterate_observed_cameras,
    observed_points_base,
    observed_points_body,
)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_small_motion_jacobian(J: Floats, points: Floats, out: Floats) -> None:
    """Into out (n, 2, 6) the derivatives to small motions on the right, from those J (n, 2, 3) to the points (n, 3)
    that they move.
    """
    for n in range(len(J)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for c in range(2):
            a, b, d = J[n, c, 0], J[n, c, 1], J[n, c, 2]
            out[n, c, 0], out[n, c, 1], out[n, c, 2] = a, b, d
            out[n, c, 3], out[n, c, 4], out[n, c, 5] = y * d - z * b, z * a - x * d, x * b - y * a


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_rotated_jacobian(J: Floats, R: Floats, rotation_index: Integers, mask: Booleans, out: Floats) -> None:
    """Into out (n, 2, 3) J (n, 2, 3) times the matrix of R (m, 3, 3) that each is `rotation_index` (n,), or J itself
    but for `mask` (n,).
    """
    for n in range(len(J)):
        for c in range(2):
            for k in range(3):
                out[n, c, k] = J[n, c, k]
                if mask[n]:
                    out[n, c, k] = (
                        J[n, c, 0] * R[rotation_index[n], 0, k]
                        + J[n, c, 1] * R[rotation_index[n], 1, k]
                        + J[n, c, 2] * R[rotation_index[n], 2, k]
                    )


@njit(cache=True, nogil=True, error_model="numpy")
def whiten_and_scale_rows_in_place(whitening: Floats, column_scale: Floats, marker: Integers, rows: Floats) -> None:
    """Whiten and scale the rows of each corner in place.

    Their columns are scaled by the column scale of its marker.
    whitening : (n, 2, 2); column_scale : (markers, k); marker : (n,); rows : (n, 2, k)
    """
    for n in range(len(rows)):
        for k in range(rows.shape[2]):
            u, v = rows[n, 0, k] * column_scale[marker[n], k], rows[n, 1, k] * column_scale[marker[n], k]
            rows[n, 0, k] = whitening[n, 0, 0] * u + whitening[n, 0, 1] * v
            rows[n, 1, k] = whitening[n, 1, 0] * u + whitening[n, 1, 1] * v


@njit(cache=True, nogil=True, error_model="numpy")
def add_corners_to_normal_equations(
    rows: Floats,
    frame: Integers,
    marker: Integers,
    frame_columns: Integers,
    shared_columns: Floats,
    sums: tuple[Floats, Floats, Floats, Floats, Floats],
) -> None:
    """Add a camera's corners to the sums of normal equations.
    sums : local (F, l, l), cross (F, l, s), shared (s, s), own (F, l), common (s,)

    rows : (n, 2, k + w + 1) derivatives to unknowns of the corner's frame, to shared ones, and residual;
        frame, marker : (n,), each sighting's
    corners together; frame_columns : (k,); shared_columns : (markers, w)
    """
    local, cross, shared, own, common = sums
    k, w = len(frame_columns), shared_columns.shape[1]
    width = k + w + 1
    square = np.zeros((width, width))
    for n in range(len(rows)):
        for c in range(2):
            for a in range(width):
                for b in range(a + 1):
                    square[a, b] += rows[n, c, a] * rows[n, c, b]
        if n + 1 < len(rows) and frame[n + 1] == frame[n] and marker[n + 1] == marker[n]:
            continue
        f, columns = frame[n], shared_columns[marker[n]]
        for a in range(k):
            own[f, frame_columns[a]] += square[width - 1, a]
            for b in range(a + 1):
                local[f, frame_columns[a], frame_columns[b]] += square[a, b]
                if a != b:
                    local[f, frame_columns[b], frame_columns[a]] += square[a, b]
        for a in range(w):
            at = columns[a]
            common[at] += square[width - 1, k + a]
            for b in range(k):
                cross[f, frame_columns[b], at] += square[k + a, b]
            for b in range(a + 1):
                shared[at, columns[b]] += square[k + a, k + b]
                if a != b:
                    shared[columns[b], at] += square[k + a, k + b]
        square[:] = 0.0


CameraJacobians = tuple[int, slice, Floats, Floats, Floats, Floats]  # see `iterate_camera_jacobians`
Derivative = tuple[int, slice, Floats, Floats, Floats]  # see `corner_jacobians_to_poses_and_lens_by_camera`


def iterate_camera_jacobians(observations: Observations, state: State) -> Iterator[CameraJacobians]:
    """Iterate over the cameras' corner Jacobians.

    Each one's corner Jacobians to base points, camera pose and lens.

    Yields (camera index, rows, uv (m, 2) px, J_base (m, 2, 3), J_camera (m, 2, 6), J_lens (m, 2, 4 + terms)).

    J_base : to the corner's place in the base frame, px/m; J_camera : to a small motion of the camera on the right
        (px/m, px/rad)
    """
    base = observed_points_base(observations, state)
    for i, camera, rows in iterate_observed_cameras(observations, state):
        frame = observations.frame[rows]
        ahead = base_points_in_camera_frame(base[rows], frame, state, i)
        uv, J_point, J_lens = lens.projected_pixels_and_jacobians(ahead, camera.matrix, camera.distortion)
        R_camera = state.moving.get(i, camera.pose).rotation.as_matrix().reshape(-1, 3, 3)
        J_base = rotate_jacobian(
            J_point,
            np.ascontiguousarray(np.swapaxes(R_camera, 1, 2)),
            frame if i in state.moving else np.zeros(len(frame), int),
        )
        yield i, rows, uv, J_base, -small_motion_jacobian(J_point, ahead), J_lens


def small_motion_jacobian(J_point: Floats, points: Floats) -> Floats:
    """Jacobian (n, 2, 6) to a small motion on the right, from the Jacobian to the moved points (n, 2, 3).

    points : (n, 3) in the moved frame
    """
    out = np.empty((len(J_point), 2, 6))
    _fill_small_motion_jacobian(np.ascontiguousarray(J_point), np.ascontiguousarray(points), out)
    return out


def rotate_jacobian(J: Floats, R: Floats, rotation_index: Integers, mask: Booleans | None = None) -> Floats:
    """Jacobian (n, 2, 3) times the rotation matrix of each row, or itself outside the mask.

    J : (n, 2, 3); R : (m, 3, 3); rotation_index : (n,) into R; mask : (n,) bool, all by default
    """
    out = np.empty(J.shape)
    _fill_rotated_jacobian(
        np.ascontiguousarray(J), R, rotation_index, np.ones(len(J), bool) if mask is None else mask, out
    )
    return out


def corner_jacobians_to_poses_and_lens_by_camera(observations: Observations, state: State) -> list[Derivative]:
    """Corner Jacobians of each camera to the platform's pose, the camera's pose and the lens.
    Returns [(camera index, rows, J_platform (m, 2, 6), J_camera (m, 2, 6), J_lens (m, 2, 4 + terms))] of the
    cameras that see something.

    observations : Observations; state : State. Tangents stand on the right (px/m, px/rad); J_platform is zero on base
        markers
    """
    R_platform, out = state.platform.rotation.as_matrix(), []
    for i, rows, _, J_base, J_camera, J_lens in iterate_camera_jacobians(observations, state):
        on = observations.on_platform[rows][:, None, None]
        J_platform = np.where(
            on,
            small_motion_jacobian(
                rotate_jacobian(J_base, R_platform, observations.frame[rows]), observations.points[rows]
            ),
            0.0,
        )
        out.append((i, rows, J_platform, J_camera, J_lens))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """What one camera's corners say, whitened, per scaled unknown. rows : slice of the observations.

    whole : (n, 2, k + w + 1) to k unknowns of the corner's frame, to w shared unknowns, and the residual
    own_columns : (k,) theirs in the frame's block; shared_columns : (m, w) theirs, for a corner of each marker
    """

    rows: slice
    whole: Floats
    own_columns: Integers
    shared_columns: Floats

    @property
    def own(self) -> Floats:
        """(n, 2, k) to unknowns of the corner's frame."""
        return self.whole[..., : len(self.own_columns)]

    @property
    def shared(self) -> Floats:
        """(n, 2, w) to shared unknowns."""
        return self.whole[..., len(self.own_columns) : -1]


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Normal equations. local : (F, l, l); cross : (F, l, s); shared : (s, s); right sides own : (F, l),
    common : (s,).
    """

    local: Floats
    cross: Floats
    shared: Floats
    own: Floats
    common: Floats


def whitened_residuals_and_derivatives(
    observations: Observations, estimate: Estimate, unknowns: Unknowns, whitener: Whitener
) -> tuple[Floats, dict[int, Derivatives]]:
    """Whitened residuals (n, 2) of corners, and {camera index: Derivatives}.

    The linearised prediction.
    whitener : Whitener of the observations
    """
    state = estimate.state
    body = observed_points_body(observations, state)
    R_platform = state.platform.rotation.as_matrix()
    markers = observations.marker.max(initial=0) + 1
    if unknowns.markers or unknowns.prints.rows:
        R_marker, in_marker = state.placed.T_body_marker.rotation.as_matrix(), state.placed.in_marker
    if unknowns.targets:
        arms, turns = _about_targets(estimate, unknowns)

    def one(view: CameraJacobians) -> Derivatives:
        i, rows, uv, J_base, J_camera, J_lens = view
        on, marker, corner = observations.on_platform[rows], observations.marker[rows], observations.corner[rows]
        J_body = rotate_jacobian(J_base, R_platform, observations.frame[rows], on)
        own_columns: list[Integers]
        local, own_columns = (
            [np.where(on[:, None, None], small_motion_jacobian(J_body, body[rows]), 0.0)],
            [np.arange(6)],
        )
        shared, columns = [np.zeros((len(on), 2, 0))], [np.zeros((markers, 0), int)]
        if i in unknowns.local_poses:
            local.append(J_camera)
            own_columns.append(_range(unknowns.local_poses[i]))
        for of, J in ((unknowns.poses, J_camera), (unknowns.lenses, J_lens)):
            if i in of:
                shared.append(J)
                columns.append(np.tile(_range(of[i]), (markers, 1)))
        if unknowns.markers or unknowns.prints.rows:
            J_marker, at = rotate_jacobian(J_body, R_marker, marker), in_marker[marker, corner]
        if unknowns.markers:
            shared.append(small_motion_jacobian(J_marker, at))
            columns.append(np.array([_range(unknowns.markers.get(row, slice(0, 6))) for row in range(markers)]))
        if unknowns.prints.rows:
            printed = printing_error_jacobian(J_marker, small_motion_jacobian(J_marker, at), at)
            parts = unknowns.prints.parts
            if unknowns.prints.together.stop > unknowns.prints.together.start:
                shared.append(printed[..., SIDE:])
                columns.append(np.tile(_range(unknowns.prints.together), (markers, 1)))
            shared.append(printed[..., parts])
            columns.append(
                np.array([_range(unknowns.prints.rows.get(row, slice(0, len(parts)))) for row in range(markers)])
            )
        if unknowns.targets:
            shared.append(small_motion_jacobian(rotate_jacobian(J_body, turns, marker), arms[marker, corner]))
            names = state.placed.target[:markers]
            columns.append(np.array([_range(unknowns.targets.get(name, slice(0, 6))) for name in names]))
        every, mine = np.concatenate(columns, axis=1), np.concatenate(own_columns)
        whole = np.concatenate([*local, *shared, (observations.uv[rows] - uv)[..., None]], axis=-1)
        scale = np.concatenate(
            [np.full((markers, len(mine)), POSE_SCALE), unknowns.scale[every], np.ones((markers, 1))], axis=1
        )
        whiten_and_scale_rows_in_place(whitener.own[rows], scale, marker, whole)
        return Derivatives(rows, whitener.mix(whole, rows), mine, every)

    residual, found = np.empty((len(observations), 2)), {}
    views = list(iterate_camera_jacobians(observations, state))
    for view, derivatives in zip(views, thread_map(one, views)):
        residual[derivatives.rows], found[view[0]] = derivatives.whole[..., -1], derivatives
    return residual, found


def _range(columns: slice) -> Integers:
    return np.arange(columns.start, columns.stop)


def _about_targets(estimate: Estimate, unknowns: Unknowns) -> tuple[Floats, Floats]:
    """Corners (m, 4, 3) m along each target's own axes, about its middle, and those axes (m, 3, 3) in the body."""
    markers = estimate.state.placed
    shift = estimated_marker_motions_by_target_motions(estimate, unknowns)
    middle = np.array([unknowns.middles.get(name, np.zeros(3)) for name in markers.target])
    turns = shift.rotation.as_matrix()
    before = (markers.corners - shift.translation[:, None]) @ turns  # the corners, their target's motion taken back
    return before - middle[:, None], turns


def normal_equations(
    observations: Observations, derivatives: dict[int, Derivatives], unknowns: Unknowns, offset: Floats
) -> Blocks:
    """Normal equations as Blocks, from the whitened residuals, their derivatives and the priors.
    offset : (s,) scaled, from the stated
    """
    frames, l, s = len(observations.frames), unknowns.local, unknowns.shared
    blocks = Blocks(
        np.zeros((frames, l, l)),
        np.zeros((frames, l, s)),
        np.diag(unknowns.prior),
        np.zeros((frames, l)),
        -unknowns.prior * offset,
    )
    sums = blocks.local, blocks.cross, blocks.shared, blocks.own, blocks.common
    for found in derivatives.values():
        add_corners_to_normal_equations(
            found.whole,
            observations.frame[found.rows],
            observations.marker[found.rows],
            found.own_columns,
            found.shared_columns,
            sums,
        )
    blocks.local[:, np.arange(l), np.arange(l)] += ~unknowns.used  # unknowns that nothing sees stay put
    return blocks


def solve_shared_and_frame_steps(blocks: Blocks, unknowns: Unknowns, damping: float = 0.0) -> tuple[Floats, Floats]:
    """Solved step of the shared unknowns (s,) and of each frame (F, l).

    Scaled, by the Schur complement.
    """
    diagonal = np.einsum("fii->fi", blocks.local)
    H = blocks.local + damping * diagonal[:, :, None] * np.eye(unknowns.local)
    solved = np.linalg.solve(H, np.concatenate([blocks.cross, blocks.own[..., None]], axis=-1))
    reduced, right = _reduced(blocks, solved)
    reduced += damping * np.diag(np.diag(blocks.shared))
    basis = unknowns.basis
    shared = (
        basis @ np.linalg.solve(basis.T @ reduced @ basis, basis.T @ right)
        if basis.shape[1]
        else np.zeros(unknowns.shared)
    )
    return shared, solved[..., -1] - solved[..., :-1] @ shared


def predicted_cost_decrease(blocks: Blocks, shared_step: Floats, local_step: Floats) -> float:
    """Predicted decrease of the cost by steps.

    They are the undamped ones of `solve_shared_and_frame_steps`, to first order.
    shared_step, local_step : the steps (s,), (frames, l), scaled, as `solve_shared_and_frame_steps` gives them
    """
    return float(blocks.common @ shared_step + (blocks.own * local_step).sum())


def schur_complement(blocks: Blocks) -> tuple[Floats, Floats, Floats]:
    """Schur complement of the shared unknowns.

    The frames' own unknowns are eliminated; own = ... - gain @ shared.

    Returns (gain (F, l, s), reduced (s, s), right (s,))
    """
    solved = np.linalg.solve(blocks.local, np.concatenate([blocks.cross, blocks.own[..., None]], axis=-1))
    return solved[..., :-1], *_reduced(blocks, solved)


def _reduced(blocks: Blocks, solved: Floats) -> tuple[Floats, Floats]:
    s = blocks.shared.shape[0]
    both = blocks.cross.reshape(blocks.own.size, s).T @ solved.reshape(blocks.own.size, s + 1)
    return blocks.shared - both[:, :-1], blocks.common - both[:, -1]
