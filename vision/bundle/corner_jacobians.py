"""How corners move when the platform, a camera or a lens does: the Jacobians of the forward model of seeing, without
effects.
"""

from collections.abc import Iterator

import numpy as np

from vision import lens
from vision.bundle import normal_equation_kernels
from vision.corner_observations import Observations
from vision.predict import State, base_points, by_camera, in_camera

Seen = tuple[int, slice, np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # see `camera_jacobians`
Derivative = tuple[int, slice, np.ndarray, np.ndarray, np.ndarray]  # see `corner_jacobians`


def camera_jacobians(observations: Observations, state: State) -> Iterator[Seen]:
    """Yield (camera index, rows, uv (m, 2) px, J_base (m, 2, 3), J_camera (m, 2, 6), J_lens (m, 2, 4 + terms)) for each
    camera that sees.

    J_base : to the corner's place in the base frame, px/m; J_camera : to a small motion of the camera on the right
        (px/m, px/rad)
    """
    base = base_points(observations, state)
    for i, camera, rows in by_camera(observations, state):
        frame = observations.frame[rows]
        ahead = in_camera(base[rows], frame, state, i)
        uv, J_point, J_lens = lens.project_jacobian(ahead, camera.matrix, camera.distortion)
        R_camera = state.moving.get(i, camera.pose).rotation.as_matrix().reshape(-1, 3, 3)
        J_base = rotate_jacobian(
            J_point,
            np.ascontiguousarray(np.swapaxes(R_camera, 1, 2)),
            frame if i in state.moving else np.zeros(len(frame), int),
        )
        yield i, rows, uv, J_base, -motion_jacobian(J_point, ahead), J_lens


def motion_jacobian(J: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 2, 6) derivative to a small motion on the right, from that to the point (n, 2, 3) and the point (n, 3) it
    moves.
    """
    out = np.empty((len(J), 2, 6))
    normal_equation_kernels.motion_derivatives(np.ascontiguousarray(J), np.ascontiguousarray(points), out)
    return out


def rotate_jacobian(J: np.ndarray, R: np.ndarray, at: np.ndarray, some: np.ndarray | None = None) -> np.ndarray:
    """(n, 2, 3) J (n, 2, 3) times the matrix of R (m, 3, 3) that each is `at` (n,), or J itself where it is none of
    `some` (n,), all by default.
    """
    out = np.empty(J.shape)
    normal_equation_kernels.rotate_derivatives(
        np.ascontiguousarray(J), R, at, np.ones(len(J), bool) if some is None else some, out
    )
    return out


def corner_jacobians(observations: Observations, state: State) -> list[Derivative]:
    """[(camera index, rows, J_platform (m, 2, 6), J_camera (m, 2, 6), J_lens (m, 2, 4 + terms))] for each camera that
    sees something.

    observations : Observations; state : State. Tangents stand on the right (px/m, px/rad); J_platform is zero on base
        markers
    """
    R_platform, out = state.platform.rotation.as_matrix(), []
    for i, rows, _, J_base, J_camera, J_lens in camera_jacobians(observations, state):
        on = observations.on_platform[rows][:, None, None]
        J_platform = np.where(
            on,
            motion_jacobian(rotate_jacobian(J_base, R_platform, observations.frame[rows]), observations.points[rows]),
            0.0,
        )
        out.append((i, rows, J_platform, J_camera, J_lens))
    return out
