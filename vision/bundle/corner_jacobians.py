"""Jacobians of predicted corners, and compiled kernels that whiten and sum them into normal equations."""

from collections.abc import Iterator

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.numba_kernels_and_lazy_exports import njit
from vision import lens
from vision.corner_observations import Observations
from vision.predict import State, iterate_observed_cameras, observed_points_base, points_in_camera_frame


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
def whiten_and_scale_rows(whitening: Floats, column_scale: Floats, marker: Integers, rows: Floats) -> None:
    """Whiten the rows of each corner in place, and scale their columns by the column scale of its marker.
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
Derivative = tuple[int, slice, Floats, Floats, Floats]  # see `corner_jacobians`


def iterate_camera_jacobians(observations: Observations, state: State) -> Iterator[CameraJacobians]:
    """Iterate over the cameras: each one's corner Jacobians to base points, camera pose and lens.
    Yields (camera index, rows, uv (m, 2) px, J_base (m, 2, 3), J_camera (m, 2, 6), J_lens (m, 2, 4 + terms)).

    J_base : to the corner's place in the base frame, px/m; J_camera : to a small motion of the camera on the right
        (px/m, px/rad)
    """
    base = observed_points_base(observations, state)
    for i, camera, rows in iterate_observed_cameras(observations, state):
        frame = observations.frame[rows]
        ahead = points_in_camera_frame(base[rows], frame, state, i)
        uv, J_point, J_lens = lens.project_jacobian(ahead, camera.matrix, camera.distortion)
        R_camera = state.moving.get(i, camera.pose).rotation.as_matrix().reshape(-1, 3, 3)
        J_base = rotate_jacobian(
            J_point,
            np.ascontiguousarray(np.swapaxes(R_camera, 1, 2)),
            frame if i in state.moving else np.zeros(len(frame), int),
        )
        yield i, rows, uv, J_base, -small_motion_jacobian(J_point, ahead), J_lens


def small_motion_jacobian(J_point: Floats, points: Floats) -> Floats:
    """(n, 2, 6) Jacobian to a small motion on the right, from the Jacobian to the moved points (n, 2, 3).
    points : (n, 3) in the moved frame
    """
    out = np.empty((len(J_point), 2, 6))
    _fill_small_motion_jacobian(np.ascontiguousarray(J_point), np.ascontiguousarray(points), out)
    return out


def rotate_jacobian(J: Floats, R: Floats, rotation_index: Integers, mask: Booleans | None = None) -> Floats:
    """(n, 2, 3) Jacobian rotated: J times the rotation matrix of each row, or J itself outside the mask.
    J : (n, 2, 3); R : (m, 3, 3); rotation_index : (n,) into R; mask : (n,) bool, all by default
    """
    out = np.empty(J.shape)
    _fill_rotated_jacobian(
        np.ascontiguousarray(J), R, rotation_index, np.ones(len(J), bool) if mask is None else mask, out
    )
    return out


def corner_jacobians(observations: Observations, state: State) -> list[Derivative]:
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
