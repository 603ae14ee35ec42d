"""Poses and design -> corners: the one forward model of seeing."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.design import Camera
from rig.pose import transform_points
from vision import lens

STEEPEST = np.cos(np.radians(78))  # markers seen more obliquely than this are not expected
INSIDE = 2.0  # px; an expected marker's corners lie this far inside the image


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Cameras (fixed ones posed), platform : T_base_platform (F,), moving : {camera index: T_base_camera (F,)}."""

    cameras: tuple[Camera, ...]
    platform: RigidTransform
    moving: dict[int, RigidTransform]


def predict(observations, state):
    """Pixels (n, 2) where the corners should be, and the points (n, 3) m in their camera's frame; z <= 0 is behind it."""
    base, uv, ahead = base_points(observations, state), np.empty((len(observations), 2)), np.empty((len(observations), 3))
    for i, camera, rows in by_camera(observations, state):
        ahead[rows] = in_camera(base[rows], observations.frame[rows], state, i)
        uv[rows] = lens.project(ahead[rows], camera.matrix, camera.distortion)
    return uv, ahead


def expected(camera, T_base_platform, marker_map):
    """Marker rows (k,) that a camera should see whole, were nothing in the way, and their corners (k, 4, 2) px."""
    points = marker_map.corners.copy()
    on = marker_map.on_platform
    points[on] = transform_points(T_base_platform, points[on].reshape(-1, 3)).reshape(-1, 4, 3)
    ahead = transform_points(camera.pose.inv(), points.reshape(-1, 3)).reshape(-1, 4, 3)
    out = np.cross(ahead[:, 3] - ahead[:, 0], ahead[:, 1] - ahead[:, 0])
    centre = ahead.mean(axis=1)
    cosine = -np.einsum("mi,mi->m", out, centre) / np.linalg.norm(out, axis=1) / np.linalg.norm(centre, axis=1)
    rows = np.flatnonzero((cosine > STEEPEST) & (ahead[..., 2] > 1e-3).all(axis=1))
    uv = lens.project(ahead[rows], camera.matrix, camera.distortion)
    inside = ((uv > INSIDE) & (uv < np.array([camera.width, camera.height]) - 1 - INSIDE)).all(axis=(1, 2))
    return rows[inside], uv[inside]


def by_camera(observations, state):
    """(camera index, Camera, slice of its corners) for each camera that sees something."""
    edges = np.searchsorted(observations.camera, np.arange(len(state.cameras) + 1))
    for i, camera in enumerate(state.cameras):
        if edges[i] < edges[i + 1]:
            yield i, camera, slice(edges[i], edges[i + 1])


def base_points(observations, state):
    """(n, 3) m, the observed points in the base frame."""
    points = observations.points.copy()
    on = observations.on_platform
    matrix = state.platform.as_matrix()[observations.frame[on]]
    points[on] = (matrix[:, :3, :3] @ points[on][..., None])[..., 0] + matrix[:, :3, 3]
    return points


def in_camera(points, frame, state, i):
    """Points (n, 3) m of the base, each at its frame (n,), in the frame of camera i."""
    if i in state.moving:
        matrix = state.moving[i].inv().as_matrix()[frame]
        return (matrix[:, :3, :3] @ points[..., None])[..., 0] + matrix[:, :3, 3]
    return transform_points(state.cameras[i].pose.inv(), points)
