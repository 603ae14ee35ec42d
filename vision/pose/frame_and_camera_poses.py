"""Poses in each frame, and camera poses.

Of all bodies in each frame; camera poses come from body poses.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.model.design import Camera
from rig.model.pose import transform_points
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import MarkerMap
from vision.pose.body_pose import (
    CONSENSUS,
    BodyCorners,
    Located,
    Unsolved,
    body_pose_from_corners,
    inverse_pose,
    undistorted_corners_and_covariance,
)
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import (
    Poses,
    choose_poses_by_neighbours,
    rotation_outlier_reasons_by_frame,
)

SHARED = 3  # frames that two cameras must share for the body to say how they stand to each other
TOGETHER = 16  # frames that one process locates before it takes more
PLATFORM = -1  # among the bodies of `vouched`; a moving camera's own number stands for the base seen from it

Call = tuple[int, Integers, Floats]  # frame, rows of the observations, T_camera_world (c, 4, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """poses : {frame: (4, 4) T_base_platform}; moving : {camera: {frame: (4, 4) T_base_camera}}; unsolved : {frame:
    reason}
    confirmed : {(frame, body)} whose one sighting the frames before and after confirm."""

    poses: Poses
    moving: dict[int, Poses]
    unsolved: dict[int, str]
    confirmed: set[tuple[int, int]]

    def all_poses(self, count: int) -> RigidTransform:
        """RigidTransform (count,) of the platform, the identity where there is none."""
        return _filled(self.poses, count)

    def all_moving(self, count: int) -> dict[int, RigidTransform]:
        """{camera: RigidTransform (count,)}, the identity where there is none."""
        return {i: _filled(T, count) for i, T in self.moving.items()}


def _filled(poses: Poses, count: int) -> RigidTransform:
    matrices = np.tile(np.eye(4), (count, 1, 1))
    for f, matrix in poses.items():
        matrices[f] = matrix
    return RigidTransform.from_matrix(matrices)


class UndistortedCorners:
    """Corners of a recording's observations, the lens taken out of all of them once."""

    def __init__(
        self, observations: Observations, cameras: Sequence[Camera], marker_map: MarkerMap, finest: float
    ) -> None:
        self.observations = observations.with_points(observations.body_points(marker_map))
        self.map, self.finest = marker_map, finest
        self.ideal, self.covariance = undistorted_corners_and_covariance(
            observations.uv, observations.covariance, observations.camera, cameras
        )
        self.normals = marker_map.T_body_marker.rotation.as_matrix()[:, :, 2][observations.marker]
        self.focal = np.array([np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]) for camera in cameras])
        self.identity = np.broadcast_to(np.eye(4), (len(cameras), 4, 4))

    def take(self, mask: Booleans) -> "UndistortedCorners":
        """The same recording with only the corners of a mask (n,)."""
        some = copy(self)
        some.observations, some.ideal, some.covariance, some.normals = (
            self.observations.take(mask),
            self.ideal[mask],
            self.covariance[mask],
            self.normals[mask],
        )
        return some

    def locate(self, rows: Integers, T_camera_world: Floats, ideal: Floats | None = None) -> Located | Unsolved:
        """Located or Unsolved from the observations' rows. T_camera_world : (c, 4, 4)."""
        o = self.observations
        ideal = self.ideal[rows] if ideal is None else ideal
        return body_pose_from_corners(
            BodyCorners(
                o.points[rows],
                self.normals[rows],
                ideal,
                self.covariance[rows],
                o.camera[rows],
                o.marker[rows],
                o.corner[rows],
                self.focal,
                T_camera_world,
            ),
            self.map,
            self.finest,
        )


def locate_fixed_cameras(
    undistorted_corners: UndistortedCorners, cameras: Sequence[Camera]
) -> dict[int, RigidTransform]:
    """Locate the fixed cameras.

    It is by base corners, median over frames.
    Returns {camera index: T_base_camera}
    """
    o, found = undistorted_corners.observations, {}
    for i, camera in enumerate(cameras):
        if camera.mount == "moving":
            continue
        rows = np.flatnonzero(~o.on_platform & (o.camera == i))
        key = o.marker[rows] * 4 + o.corner[rows]
        keys, first = np.unique(key, return_index=True)
        ideal = np.array([np.median(undistorted_corners.ideal[rows[key == k]], axis=0) for k in keys]).reshape(-1, 2)
        located = undistorted_corners.locate(rows[first], undistorted_corners.identity, ideal)
        if located:
            found[i] = located.T_world_body.inv()
    return found


def locate_cameras_without_base_targets(
    undistorted_corners: UndistortedCorners, cameras: Sequence[Camera]
) -> dict[int, RigidTransform]:
    """Locate fixed cameras without base targets.

    It is by the body that they all see.
    Nothing where fewer than two share SHARED frames or some camera sees the base or moves.

    Returns {camera index: T_base_camera}
    """
    o = undistorted_corners.observations
    if not o.on_platform.all() or any(camera.mount == "moving" for camera in cameras):
        return {}
    alone = {}  # (camera, frame): T_camera_body
    for i in np.unique(o.camera).tolist():
        for f in np.unique(o.frame[o.camera == i]).tolist():
            answer = undistorted_corners.locate(
                np.flatnonzero((o.camera == i) & (o.frame == f)), undistorted_corners.identity
            )
            if answer:
                alone[i, f] = answer.T_world_body
    frames = {i: {f for j, f in alone if j == i} for i in np.unique(o.camera).tolist()}
    first = max(frames, key=lambda i: len(frames[i]))
    found = {first: RigidTransform.identity()}
    for i, own in frames.items():
        both = sorted(own & frames[first])
        if i != first and len(both) >= SHARED:
            steps = RigidTransform.concatenate([alone[first, f] * alone[i, f].inv() for f in both])
            found[i] = RigidTransform.from_components(np.median(steps.translation, axis=0), steps.rotation.mean())
    if len(found) < 2:
        return {}
    turn = RigidTransform.concatenate([cameras[i].pose * T.inv() for i, T in found.items()]).rotation.mean()
    shift = np.mean([cameras[i].pose.translation - turn.apply(T.translation) for i, T in found.items()], axis=0)
    return {i: RigidTransform.from_components(shift, turn) * T for i, T in found.items()}


def locate_platform_and_moving_cameras(
    undistorted_corners: UndistortedCorners,
    cameras: Sequence[Camera],
    t: Floats | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Frames:
    """Locate the platform and moving cameras in all frames, as Frames.
    t : (F,) s; with it, a single sighting is checked against its neighbours in time

    progress : called with (done, of), or None
    """
    o, count = undistorted_corners.observations, len(undistorted_corners.observations.frames)
    moving, unsolved, vouched = {}, {}, set()
    by_frame = np.argsort(o.frame, kind="stable")
    edges = np.searchsorted(o.frame[by_frame], np.arange(count + 1))
    rows_of = [by_frame[edges[f] : edges[f + 1]] for f in range(count)]
    lost = {}
    for i, camera in enumerate(cameras):
        if camera.mount != "moving":
            continue
        calls = [
            (f, rows[~o.on_platform[rows] & (o.camera[rows] == i)], undistorted_corners.identity)
            for f, rows in enumerate(rows_of)
        ]
        found, alone, why = _decided(_answers(undistorted_corners, calls), t)
        moving[i] = {f: inverse_pose(matrix) for f, matrix in found.items()}
        vouched |= {(f, i) for f in alone}
        lost[i] = {f: f"moving camera {camera.name!r} is lost: {reason}" for f, reason in why.items()}
    fixed = np.array([camera.pose.inv().as_matrix() for camera in cameras])
    calls = []
    for f, rows in enumerate(rows_of):
        T_camera_world = fixed.copy()
        for i, poses in moving.items():
            if f in poses:
                T_camera_world[i] = inverse_pose(poses[f])
            else:
                poses[f] = cameras[i].pose.as_matrix()
        seen = rows[o.on_platform[rows]]
        known = np.array([f not in lost.get(i, {}) for i in o.camera[seen].tolist()], bool)
        if len(seen) and not known.any():
            unsolved[f] = next(lost[i][f] for i in o.camera[seen].tolist())
        else:
            calls.append((f, seen[known], T_camera_world))
    answers = _answers(undistorted_corners, calls, progress)
    poses, alone, why = _decided(answers, t)
    return Frames(poses, moving, unsolved | why, vouched | {(f, PLATFORM) for f in alone})


def _answers(
    undistorted_corners: UndistortedCorners, calls: Sequence[Call], progress: Callable[[int, int], None] | None = None
) -> dict[int, Located | Unsolved]:
    """{frame: Located or Unsolved} of calls, on all cores where they are many."""
    parts = [calls[at : at + TOGETHER] for at in range(0, len(calls), TOGETHER)]
    found = parallel_map(
        lambda part: [undistorted_corners.locate(rows, T) for _, rows, T in part],
        parts,
        progress and (lambda done, of: progress(min(done * TOGETHER, len(calls)), len(calls))),
    )
    return {f: answer for part, answers in zip(parts, found) for (f, _, _), answer in zip(part, answers)}


def _decided(answers: dict[int, Located | Unsolved], t: Floats | None) -> tuple[Poses, set[int], dict[int, str]]:
    """({frame: (4, 4) T_world_body}, frames decided by their neighbours, {frame: reason}) of {frame: Located or
    Unsolved}.
    """
    found = {f: answer.matrix for f, answer in answers.items() if answer}
    why = {f: answer.reason for f, answer in answers.items() if not answer}
    chosen = {}
    if t is not None:
        for f, reason in rotation_outlier_reasons_by_frame(found, t).items():
            del found[f]
            why[f] = reason
        doubtful: dict[int, Sequence[Floats]] = {
            f: [one.matrix for one in answer.candidates]
            for f, answer in answers.items()
            if not answer and answer.candidates
        }
        chosen = choose_poses_by_neighbours(found, doubtful, t)
        why.update(
            {f: f"{why[f]}, and the frames before and after do not resolve it" for f in doubtful if f not in chosen}
        )
    return found | chosen, set(chosen), {f: reason for f, reason in why.items() if f not in chosen}


HELD = 0.5  # share of a camera's corners near where they should be, from which it stands where it is taken to stand
MOST = 60  # sightings of markers by which a camera is placed: more only take longer


def camera_poses_from_body_poses(
    undistorted_corners: UndistortedCorners,
    cameras: Sequence[Camera],
    frames: Frames,
    cameras_placed_by_base: set[int],
    t: Floats | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, RigidTransform]:
    """Camera poses {camera index: T_base_camera} from body poses.

    Of doubtful fixed cameras; the bodies' poses are by the other cameras.
    frames : Frames by all cameras as they are; cameras_placed_by_base : indices of the cameras that the base placed; t
        : (F,) s, as of `locate_platform_and_moving_cameras`
    progress : called with (done, of), or None
    """
    loose = [
        i
        for i, camera in enumerate(cameras)
        if camera.mount != "moving"
        and i not in cameras_placed_by_base
        and not _stands(undistorted_corners, cameras, frames, i)
    ]
    if not loose or len(loose) == len(cameras):
        return {}
    by_others = locate_platform_and_moving_cameras(
        undistorted_corners.take(~np.isin(undistorted_corners.observations.camera, loose)), cameras, t, progress
    )
    placed = {i: _placed(undistorted_corners, by_others, i) for i in loose}
    return {i: pose for i, pose in placed.items() if pose is not None}


def _stands(undistorted_corners: UndistortedCorners, cameras: Sequence[Camera], found: Frames, i: int) -> bool:
    """Whether a fixed camera's corners, those of frames without a pose counted against it, lie mostly where the frames'
    poses put them.
    """
    o, count = undistorted_corners.observations, len(undistorted_corners.observations.frames)
    rows = np.flatnonzero(o.camera == i)
    points, moved = o.points[rows].copy(), o.on_platform[rows]
    points[moved] = transform_points(found.all_poses(count)[o.frame[rows[moved]]], points[moved][:, None])[:, 0]
    ahead = transform_points(cameras[i].pose.inv(), points)
    off = (
        np.linalg.norm(ahead[:, :2] / ahead[:, 2:] - undistorted_corners.ideal[rows], axis=1)
        * undistorted_corners.focal[i]
    )
    lost = moved & np.isin(o.frame[rows], list(found.unsolved))
    return bool((~lost & (ahead[:, 2] > 0) & (off < CONSENSUS)).mean() >= HELD) if len(rows) else True


def _placed(undistorted_corners: UndistortedCorners, found: Frames, i: int) -> RigidTransform | None:
    """T_base_camera by the markers that a camera sees at the located frames' poses and on the base, each sighting of a
    marker being one marker of a body that is the base; None where these lead to no pose."""
    o, m = undistorted_corners.observations, undistorted_corners.map
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
    seen = BodyCorners(
        world.corners[own, o.corner[rows]],
        normals,
        undistorted_corners.ideal[rows],
        undistorted_corners.covariance[rows],
        np.full(len(rows), i),
        own,
        o.corner[rows],
        undistorted_corners.focal,
        undistorted_corners.identity,
    )
    located = body_pose_from_corners(seen, world, undistorted_corners.finest)
    return located.T_world_body.inv() if located else None
