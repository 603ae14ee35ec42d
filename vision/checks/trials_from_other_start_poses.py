"""Trials begun from other start poses of the cameras.

They are of what is stated.

A camera that sees a single base marker is not located by it, since nothing checks that sighting: measuring leaves it
where it is stated, which may be too far off for any poses to explain its corners.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rig.model.design import Camera
from vision.checks.corner_and_lens_convention_trials import (
    SampledRecording,
    Trial,
    is_same_lens_within_calibration_drift,
    measure_trial,
)
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import marker_map
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import UndistortedCorners


def stated_trial_from_other_camera_poses(first: Trial, misfit: float) -> Trial | None:
    """The stated trial begun from other poses of the cameras.

    Lenses stay as stated and it leaves less than a misfit (px); None where none does.
    """
    stated = first.seen.design.cameras
    for begun in _starts(first.seen):
        tried = measure_trial(first.seen.with_cameras(begun))
        if (
            tried.measured is not None
            and tried.misfit < misfit
            and all(
                is_same_lens_within_calibration_drift(meant, found)
                for meant, found in zip(stated, tried.measured.design.cameras)
            )
        ):
            return tried
    return None


def cameras_by_free_markers(sample: SampledRecording, cameras: tuple[Camera, ...]) -> tuple[Camera, ...] | None:
    """Cameras adjusted with free places of markers.

    They are adjusted from those given; None where nothing can be solved.
    """
    measured = measure_trial(sample.with_cameras(cameras), ("poses", "lenses", "markers")).measured
    return None if measured is None else measured.design.cameras


def _starts(sample: SampledRecording) -> Iterator[tuple[Camera, ...]]:
    """Stated cameras at other poses."""
    stated = sample.design.cameras
    yield _placed_by_single_markers(sample)
    located = cameras_by_free_markers(sample, stated)
    if located is not None:
        yield tuple(replace(camera, pose=at.pose) for camera, at in zip(stated, located))


def _placed_by_single_markers(sample: SampledRecording) -> tuple[Camera, ...]:
    """Stated cameras, those that see one base marker alone at the pose by it that turns least from their own."""
    markers, cameras = marker_map(sample.design), list(sample.design.cameras)
    o = observations_from_corners(sample.corners, sample.frames, sample.design, markers)
    undistorted = UndistortedCorners(o, sample.design.cameras, markers, FINEST)
    for i, camera in enumerate(cameras):
        rows = np.flatnonzero(~o.on_platform & (o.camera == i))
        if camera.mount == "moving" or len(np.unique(o.marker[rows])) != 1:
            continue
        found = undistorted.locate(rows[o.frame[rows] == o.frame[rows[0]]], undistorted.identity)
        poses = [] if found else [one.T_world_body.inv() for one in found.candidates]
        turns = [(T.rotation.inv() * camera.pose.rotation).magnitude() for T in poses]
        if poses:
            cameras[i] = replace(camera, pose=poses[int(np.argmin(turns))])
    return tuple(cameras)
