"""A body that somebody made by hand, markers some millimetres off, turned before two fixed cameras of long focal
length; no base in sight.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.design import FACES, Actuator, Camera, Design, Free, Marker, Platform, Target, face_pose
from rig.model.pose import exp, pose
from rig.recording.recording_folder import Corners
from vision.marker_corner_prediction import State, marker_map, predict_sightings, sightings_facing_cameras_anywhere

EDGE, SIDE, WHITE = 0.12, 0.03, 0.004  # m
ON_A_FACE = ((-0.036, 0.03), (0.036, 0.03), (0.0, -0.034))  # m
SIZE, FOCAL = (1600, 1200), 3290.0  # px
CAMERAS_AT = (np.array([-0.5, -1.3, 0.3]), np.array([0.6, -1.25, 0.35]))  # m
LENS = (-0.05, 0.1, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Handmade:
    """stated, true : Design; T : RigidTransform (frames,) of the body; corners : Corners with noise (px)."""

    stated: Design
    true: Design
    T: RigidTransform
    corners: Corners


def handmade(
    seed: int, frames: int = 100, noise: float = 0.1, off: tuple[float, float] = (2e-3, 0.03), far: float = 1.0
) -> Handmade:
    """A Handmade. off : m and rad, RMS length of what the markers' places are off by; far : times the usual distance of
    the cameras
    """
    rng = np.random.default_rng([5, seed])
    places = [
        face_pose(face, EDGE) * pose([x, y, 0], [0, 0, rng.uniform(-np.pi, np.pi)])
        for face in FACES
        for x, y in ON_A_FACE
    ]
    askew = [T * exp(np.repeat(off, 3) / np.sqrt(3) * rng.normal(size=6)) for T in places]
    cameras = tuple(_looking(name, far * eye) for name, eye in zip("ab", CAMERAS_AT))
    stated = _design(tuple(_believed(c, rng) for c in cameras), places)
    true = _design(cameras, askew)
    turn, at, poses = Rotation.random(rng=rng), np.zeros(3), []
    for _ in range(frames):
        turn, at = turn * Rotation.from_rotvec(rng.normal(0, 0.25, 3)), 0.9 * at + rng.normal(0, 0.02, 3)
        poses.append(RigidTransform.from_components(at, turn))
    T, markers = RigidTransform.concatenate(poses), marker_map(true)
    state = State(true.cameras, T, {})
    shown = sightings_facing_cameras_anywhere(state, markers, 0.35)
    uv = predict_sightings(shown, state, markers)
    inside = ((uv > 5) & (uv < np.array(SIZE) - 6)).all(axis=(1, 2))
    shown, uv = shown.take(inside), uv[inside] + rng.normal(0, noise, uv[inside].shape)
    n = len(uv)
    return Handmade(
        stated,
        true,
        T,
        Corners(
            np.repeat(shown.frame, 4),
            [true.cameras[i].name for i in np.repeat(shown.camera, 4)],
            markers.id[np.repeat(shown.marker, 4)],
            np.tile(np.arange(4), n),
            uv.reshape(-1, 2),
            np.tile(noise**2 * np.eye(2), (4 * n, 1, 1)),
        ),
    )


def _looking(name: str, eye: np.ndarray) -> Camera:
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0, 0, -1.0], z)
    x /= np.linalg.norm(x)
    turn = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1))
    centre = (np.array(SIZE) - 1) / 2
    return Camera(
        name,
        *SIZE,
        [[FOCAL, 0, centre[0]], [0, FOCAL, centre[1]], [0, 0, 1]],
        np.array(LENS),
        RigidTransform.from_components(eye, turn),
    )


def _believed(camera: Camera, rng: np.random.Generator) -> Camera:
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + rng.normal(0, 5e-4)
    matrix[[0, 1], [2, 2]] += rng.normal(0, 2, 2)
    return replace(camera, matrix=matrix, pose=camera.pose * exp(rng.normal(0, 2e-3, 6)))


def _design(cameras: tuple[Camera, ...], places: list[RigidTransform]) -> Design:
    listed = tuple(Marker(k, SIDE, T, WHITE) for k, T in enumerate(places))
    return Design(
        "block",
        np.array([0, 0, -9.8]),
        Free(),
        None,
        Actuator(None, None, None),
        Platform(None, None, None),
        cameras,
        (Target("block", "platform", "DICT_5X5_100", listed=listed),),
    )
