"""A block of 18 tags made by hand, before two fixed cameras: corners by a plain pinhole projection, with noise.

Nothing here projects or poses by the product's own functions: truth is numpy matrices; a Design only states the rig.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.design import Actuator, Camera, Design, Free, Marker, Platform, Target
from rig.recording.corner_and_pose_csv_tables import Corners

EDGE, SIDE = 0.12, 0.03  # m
ON_A_FACE = ((-0.036, 0.03), (0.036, 0.03), (0.0, -0.034))  # m
SIZE, FOCAL = np.array([1600, 1200]), 3290.0  # px
CAMERAS_AT = np.array([[-0.5, -1.3, 0.3], [0.6, -1.25, 0.35]])  # m
ARM = 0.04  # m; a stated place that is off by so much is turned by a radian
BASE = (
    (-0.2, 0.15, 0.13),
    (0.2, 0.15, 0.13),
    (-0.2, 0.15, -0.13),
    (0.2, 0.15, -0.13),
    (-0.2, -0.1, -0.2),
    (0.2, -0.1, -0.2),
)
BASE_SIDE = 0.05  # m, of the tags on the base, which face the cameras
LENS = np.array([0.1, 0.3, 0.005, 0.005, 0.3])  # standard deviations of k1, k2, p1, p2, k3 that nobody states
CENTRE = 0.02  # of the image's width, standard deviation of the principal point about the middle
STEEPEST = 0.35  # cosine of the tilt beyond which a tag is not read
FACES = {  # columns x right, y up, z out of the paper
    "+x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "-x": [[0, 0, -1], [-1, 0, 0], [0, 1, 0]],
    "+y": [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "+z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
}


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """stated : Design as its owner states it; cameras : (c, 4, 4) true T_base_camera; tags : (18, 4, 4) true
    T_body_tag; poses : (F, 4, 4) true T_base_body; focal : (c,) px, true; corners : Corners with noise
    """

    stated: Design
    cameras: np.ndarray
    tags: np.ndarray
    poses: np.ndarray
    focal: np.ndarray
    corners: Corners


def drawn_block(
    seed: int,
    frames: int = 40,
    noise: float = 0.05,
    off: float | None = 2e-3,
    focal: float = 0.01,
    tilt: float | None = None,
    far: float = 1.0,
    aside: float = 2e-3,
    base: bool = False,
    lens: float = 1.0,
) -> Block:
    """A Block. noise : px; off : m by which each stated place is wrong along each axis, and the same at the middle of
    the tag's edges in rotation; None where no place is stated; focal : share by which stated focal lengths are wrong
    aside : m and rad, standard deviation of the stated camera poses; far : times the distance and the focal length
    lens : times the usual distortion and offset of the principal point, which the stated cameras do not have
    base : whether tags stand on the base, exactly where they are stated
    tilt : rad, standard deviation of the body's turns about each axis; None for any orientation
    """
    rng = np.random.default_rng([18, seed])
    tags = np.array(
        [
            _matrix(R @ _about_z(rng.uniform(-np.pi, np.pi)), R @ [x, y, EDGE / 2])
            for R in map(np.array, FACES.values())
            for x, y in ON_A_FACE
        ]
    )
    cameras, true_focal = np.array([_looking(far * eye) for eye in CAMERAS_AT]), far * FOCAL
    turns = Rotation.random(frames, rng=rng) if tilt is None else Rotation.from_rotvec(rng.normal(0, tilt, (frames, 3)))
    poses = np.array([_matrix(R, x) for R, x in zip(turns.as_matrix(), rng.normal(0, 0.03, (frames, 3)))])
    sign = rng.choice([-1, 1], 2)
    stated_focal = true_focal * (1 + focal * sign)
    fixed = np.array([_matrix(np.array(FACES["-y"]), np.array(x)) for x in BASE if base]).reshape(-1, 4, 4)
    lenses = [
        (true_focal, (SIZE - 1) / 2 + lens * CENTRE * SIZE[0] * rng.normal(size=2), lens * LENS * rng.normal(size=5))
        for _ in cameras
    ]
    corners = _seen(cameras, lenses, poses, tags, fixed, noise, rng)
    places = [
        None if off is None else _transform(T @ _small(rng.normal(0, off, 3), rng.normal(0, off / ARM, 3)))
        for T in tags
    ]
    centre = (SIZE - 1) / 2
    believed = tuple(
        Camera(
            name,
            *SIZE.tolist(),
            np.array([[f, 0, centre[0]], [0, f, centre[1]], [0, 0, 1]]),
            np.zeros(5),
            _transform(T @ _small(rng.normal(0, aside, 3), rng.normal(0, aside, 3))),
        )
        for name, f, T in zip("ab", stated_focal, cameras)
    )
    ground = Target(
        "ground",
        "base",
        "DICT_5X5_100",
        listed=tuple(Marker(50 + k, BASE_SIDE, _transform(T), BASE_SIDE / 8) for k, T in enumerate(fixed)),
    )
    listed = tuple(Marker(k, SIDE, place, SIDE / 8, place is not None) for k, place in enumerate(places))
    stated = Design(
        "block",
        np.array([0, 0, -9.8]),
        Free(),
        None,
        Actuator(None, None, None),
        Platform(None, None, None),
        believed,
        (Target("block", "platform", "DICT_5X5_100", listed=listed), *([ground] if base else [])),
    )
    return Block(stated, cameras, tags, poses, np.full(2, true_focal), corners)


def _seen(
    cameras: np.ndarray,
    lenses: list[tuple[float, np.ndarray, np.ndarray]],
    poses: np.ndarray,
    tags: np.ndarray,
    fixed: np.ndarray,
    noise: float,
    rng: np.random.Generator,
) -> Corners:
    """Corners of all tags that face a camera and lie in its image."""
    frame, camera, marker, uv = [], [], [], []
    for f, pose in enumerate(poses):
        for c, eye in enumerate(cameras):
            back = np.linalg.inv(eye)
            visible = [(k, back @ pose @ T, SIDE) for k, T in enumerate(tags)]
            visible += [(50 + k, back @ T, BASE_SIDE) for k, T in enumerate(fixed)]
            for k, T, side in visible:
                points = placed_corners(T[None], side)[0]
                middle, out = T[:3, 3], T[:3, 2]
                pixels = _projected(points, *lenses[c])
                if -out @ middle > STEEPEST * np.linalg.norm(middle) and ((pixels > 5) & (pixels < SIZE - 6)).all():
                    frame.append(f), camera.append("ab"[c]), marker.append(k), uv.append(pixels)
    n = len(uv)
    seen = np.array(uv) + rng.normal(0, noise, (n, 4, 2))
    return Corners(
        np.repeat(frame, 4),
        np.repeat(camera, 4).tolist(),
        np.repeat(marker, 4),
        np.tile(np.arange(4), n),
        seen.reshape(-1, 2),
        None,
    )


def _projected(points: np.ndarray, focal: float, centre: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """(n, 2) px of points (n, 3) m in a camera: a pinhole behind a radial and tangential distortion (Brown 1966)."""
    (x, y), (k1, k2, p1, p2, k3) = (points[:, :2] / points[:, 2:]).T, terms
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], axis=1
    )
    return focal * bent + centre


def placed_corners(tags: np.ndarray, side: float = SIDE) -> np.ndarray:
    """(n, 4, 3) m, corners of tags (n, 4, 4) of a side (m), clockwise from the top left."""
    square = side / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])
    return square @ np.swapaxes(tags[:, :3, :3], 1, 2) + tags[:, None, :3, 3]


def _matrix(R: np.ndarray, x: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, x
    return out


def _small(shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return _matrix(Rotation.from_rotvec(turn).as_matrix(), shift)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _looking(eye: np.ndarray) -> np.ndarray:
    """T_base_camera (4, 4) of a camera that looks at the origin, OpenCV axes."""
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0, 0, -1.0], z)
    x /= np.linalg.norm(x)
    return _matrix(np.stack([x, np.cross(z, x), z], axis=1), eye)


def _transform(T: np.ndarray) -> RigidTransform:
    return RigidTransform.from_matrix(T)
