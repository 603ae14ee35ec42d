"""Poses of cameras that see too little of the base, from the platform's poses by the other cameras."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_types import Floats
from rig.model.design import Camera
from rig.model.pose import transform_points
from vision.pose.body_pose import CONSENSUS, View, locate_body
from vision.pose.frame_poses import Frames, Views, locate_frames
from vision.targets import MarkerMap

HELD = 0.5  # share of a camera's corners near where they should be, from which it stands where it is taken to stand
MOST = 60  # sightings of markers by which a camera is placed: more only take longer


def camera_poses_from_body_poses(
    views: Views,
    cameras: Sequence[Camera],
    frames: Frames,
    cameras_placed_by_base: set[int],
    t: Floats | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, RigidTransform]:
    """Poses {camera index: T_base_camera} of doubtful fixed cameras from body poses by the other cameras.

    frames : Frames by all cameras as they are; cameras_placed_by_base : indices of the cameras that the base placed; t
        : (F,) s, as of `locate_frames`
    progress : called with (done, of), or None
    """
    loose = [
        i
        for i, camera in enumerate(cameras)
        if camera.mount != "moving" and i not in cameras_placed_by_base and not _stands(views, cameras, frames, i)
    ]
    if not loose or len(loose) == len(cameras):
        return {}
    by_others = locate_frames(views.take(~np.isin(views.observations.camera, loose)), cameras, t, progress)
    placed = {i: _placed(views, by_others, i) for i in loose}
    return {i: pose for i, pose in placed.items() if pose is not None}


def _stands(views: Views, cameras: Sequence[Camera], found: Frames, i: int) -> bool:
    """Whether a fixed camera's corners, those of frames without a pose counted against it, lie mostly where the frames'
    poses put them.
    """
    o, count = views.observations, len(views.observations.frames)
    rows = np.flatnonzero(o.camera == i)
    points, moved = o.points[rows].copy(), o.on_platform[rows]
    points[moved] = transform_points(found.all_poses(count)[o.frame[rows[moved]]], points[moved][:, None])[:, 0]
    ahead = transform_points(cameras[i].pose.inv(), points)
    off = np.linalg.norm(ahead[:, :2] / ahead[:, 2:] - views.ideal[rows], axis=1) * views.focal[i]
    lost = moved & np.isin(o.frame[rows], list(found.unsolved))
    return bool((~lost & (ahead[:, 2] > 0) & (off < CONSENSUS)).mean() >= HELD) if len(rows) else True


def _placed(views: Views, found: Frames, i: int) -> RigidTransform | None:
    """T_base_camera by the markers that a camera sees at the located frames' poses and on the base, each sighting of a
    marker being one marker of a body that is the base; None where these lead to no pose."""
    o, m = views.observations, views.map
    rows = np.flatnonzero((o.camera == i) & (~o.on_platform | ~np.isin(o.frame, list(found.unsolved))))
    key = o.frame[rows] * len(m.id) + o.marker[rows]
    keys = np.unique(key)
    keys = keys[np.linspace(0, len(keys) - 1, min(MOST, len(keys))).astype(int)]
    rows, key = rows[np.isin(key, keys)], key[np.isin(key, keys)]
    if not len(rows):
        return None
    frame, marker = keys // len(m.id), keys % len(m.id)
    poses = found.all_poses(len(o.frames))
    T_base_marker = RigidTransform.concatenate(
        [
            poses[f] * m.T_body_marker[k] if m.on_platform[k] else m.T_body_marker[k]
            for f, k in zip(frame.tolist(), marker.tolist())
        ]
    )
    world = MarkerMap(
        m.id[marker],
        np.zeros(len(keys), bool),
        T_base_marker,
        m.side[marker],
        m.margin[marker],
        [m.dictionary[k] for k in marker],
        [m.target[k] for k in marker],
        np.zeros(len(keys), int),
    )
    own = np.searchsorted(keys, key)
    normals = T_base_marker.rotation.as_matrix()[:, :, 2][own]
    seen = View(
        world.corners[own, o.corner[rows]],
        normals,
        views.ideal[rows],
        views.covariance[rows],
        np.full(len(rows), i),
        own,
        o.corner[rows],
        views.focal,
        views.identity,
    )
    located = locate_body(seen, world, views.finest)
    return located.T_world_body.inv() if located else None
