"""A tagged block turned before fixed tags and a hand-held camera, drawn straight from a design whose tags sit off their
places.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.design import Actuator, Camera, Design, Free, Marker, Platform, Target, face_pose
from rig.model.pose import exp, pose
from rig.recording.recording_folder import Corners
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import (
    State,
    is_inside_image,
    marker_map,
    predict_sightings,
    sightings_facing_cameras_anywhere,
)


def design():
    lab = tuple(
        Marker(
            k,
            0.16,
            pose([0.35 * (k % 2) - 0.175, 0.1 * (k // 2), 0.3 * (k // 2)], [np.pi / 2, 0, 0.3 * (k % 2) - 0.15]),
            0.02,
        )
        for k in range(4)
    )
    block = tuple(
        Marker(100 + k, 0.05, face_pose(face, 0.08), 0.006)
        for k, face in enumerate(("+x", "-x", "+y", "-y", "+z", "-z"))
    )
    camera = Camera(
        "cam0",
        1280,
        1024,
        [[1500, 0, 640], [0, 1500, 512], [0, 0, 1]],
        [-0.23, 0.2, 0, 0, 0],
        pose([0, -1, 0.2], [-np.pi / 2, 0, 0]),
        mount="moving",
    )
    return Design(
        "tumbling",
        np.array([0, 0, -9.8]),
        Free(),
        None,
        Actuator(None, None, None),
        Platform(None, None, None),
        (camera,),
        (
            Target("lab", "base", "DICT_APRILTAG_36h11", listed=lab),
            Target("block", "platform", "DICT_APRILTAG_36h11", listed=block),
        ),
    )


def scene(seed, frames=120, noise=0.1, off=1e-3):
    """(Observations, Design stated, true State, t (F,) s). off : m, and five times as many rad, by which tags miss
    their places.
    """
    rng = np.random.default_rng(seed)
    stated, t = design(), np.arange(frames) * 0.05
    markers = marker_map(stated)
    moved = replace(
        markers,
        T_body_marker=markers.T_body_marker * exp(off * rng.normal(size=(len(markers.id), 6)) * [1, 1, 1, 5, 5, 5]),
    )
    wave = np.sin(2 * np.pi * t[:, None] / [3, 4, 5, 2.5, 3.5, 4.5] + rng.uniform(0, 6, 6))
    cameras = RigidTransform.concatenate(
        [stated.cameras[0].pose * exp(w * [0.05, 0.05, 0.1, 0.03, 0.03, 0.05]) for w in wave]
    )
    turn = Rotation.from_rotvec(np.outer(t, [0.9, 0.7, 0.5])) * Rotation.from_rotvec([0.4, 0.5, 0.3])
    platform = RigidTransform.from_components(
        np.stack([0.08 * wave[:, 0], -0.35 + 0.03 * wave[:, 1], 0.1 + 0.03 * wave[:, 2]], axis=1), turn
    )
    true = State(stated.cameras, platform, {0: cameras}, moved)
    found = sightings_facing_cameras_anywhere(true, moved, np.cos(np.radians(70)))
    uv = predict_sightings(found, true, moved)
    whole = is_inside_image(found, uv, stated.cameras, 5)
    found, uv = found.take(whole), uv[whole]
    n = len(uv)
    corners = Corners(
        np.repeat(found.frame, 4),
        ["cam0"] * 4 * n,
        np.repeat(markers.id[found.marker], 4),
        np.tile(np.arange(4), n),
        (uv + noise * rng.normal(size=uv.shape)).reshape(-1, 2),
        None,
    )
    return observations_from_corners(corners, np.arange(frames), stated, markers), stated, true, t
