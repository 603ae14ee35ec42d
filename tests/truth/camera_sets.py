"""Cameras and cubes: what is seen of a platform, corner by corner, with faults of cameras, prints and targets."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from tests.truth.motion import Conditions
from tests.truth.rigid import displaced

WIDE, HIGH = 1280, 1024  # px
FACES = ("+x", "-x", "+y", "-y", "+z")
STEEPEST = 0.35  # cosine of the angle at which a face is still read
ROUNDS = 3  # in which the row tells the moment, and the moment the row


@dataclass(frozen=True)
class Camera:
    """place : (4, 4) camera in base, looking along its z, x right, y down; focal, middle : px; lens : (5,) k1 k2 p1 p2
    k3
    """

    name: str
    place: np.ndarray
    focal: float
    middle: np.ndarray
    lens: np.ndarray


@dataclass(frozen=True)
class Cube:
    """moves : whether it stands on the platform; edge, side : m of the cube and of its markers; first : identity of the
    first face
    place : (4, 4) of its centre in its body"""

    name: str
    moves: bool
    edge: float
    side: float
    first: int
    place: np.ndarray


class Sight:
    """A fault of seeing. Subclasses override what they change."""

    row_time = 0.0  # s from a row of the image to the next

    def printed(self, cube: Cube, face: int, corners: np.ndarray) -> np.ndarray:
        """(4, 3) m corners of a face in its own plane: x right, y up, z out."""
        return corners

    def placed(self, cube: Cube) -> np.ndarray:
        """(4, 4) of a cube's centre in its body."""
        return cube.place

    def read(self, cube: Cube, face: int) -> tuple[int, int]:
        """(index of the face whose marker is there, quarter turns of it)."""
        return face, 0

    def standing(self, camera: Camera, number: int, t: np.ndarray) -> np.ndarray:
        """(n, 6) small motion of a camera at t (n,) s, in its own frame."""
        return np.zeros((len(t), 6))

    def zoom(self, number: int, t: np.ndarray, day: Conditions) -> np.ndarray:
        """(n, 2) factors on the focal length, along u and v."""
        return np.ones((len(t), 2))

    def bent(self, number: int, points: np.ndarray) -> np.ndarray:
        """(..., 3) m: where points in a camera's frame appear to be."""
        return points

    def warped(self, number: int, uv: np.ndarray) -> np.ndarray:
        """(..., 2) px as the lens really has them, of uv as stated."""
        return uv

    def bordered(self, number: int, squares: np.ndarray) -> np.ndarray:
        """(m, 4, 2) px corners as their black is seen."""
        return squares


@dataclass(frozen=True)
class CameraSet:
    """cameras : as they are; stated : as their owner has them; cubes; sigma : px of a corner, a coordinate; fault"""

    cameras: tuple[Camera, ...]
    stated: tuple[Camera, ...]
    cubes: tuple[Cube, ...]
    sigma: float
    fault: Sight

    def corners(
        self, t: np.ndarray, bodies_at: Callable[[np.ndarray], np.ndarray], day: Conditions, rng: np.random.Generator
    ) -> np.ndarray:
        """(k, 6) rows frame, camera, marker, corner, u, v of exposures at t (n,) s. bodies_at : (n,) s after these
        -> (n, 4, 4) poses of the platform.
        """
        rows = []
        still, together = np.tile(np.eye(4), (len(t), 1, 1)), bodies_at(np.zeros(len(t)))
        for number, camera in enumerate(self.cameras):
            places = displaced(np.tile(camera.place, (len(t), 1, 1)), self.fault.standing(camera, number, t))
            zoom = self.fault.zoom(number, t, day)
            for cube in self.cubes:
                for face in range(len(FACES)):
                    squares = partial(self._squares, camera, number, cube, face, places, zoom)
                    uv, ahead = squares(together if cube.moves else still)
                    if cube.moves and self.fault.row_time:
                        uv = self._rolled(uv, ahead, squares, bodies_at)
                    uv = self.fault.bordered(number, uv)
                    seen = ahead & (uv > 8).all(axis=(1, 2)) & (uv < np.array([WIDE, HIGH]) - 9).all(axis=(1, 2))
                    visible, turns = self.fault.read(cube, face)
                    uv = np.roll(uv, turns, axis=1) + rng.normal(0, self.sigma, uv.shape)
                    for frame in np.flatnonzero(seen):
                        rows += [
                            (frame, number, cube.first + visible, corner, *uv[frame, corner]) for corner in range(4)
                        ]
        return np.array(rows)

    def _squares(
        self,
        camera: Camera,
        number: int,
        cube: Cube,
        face: int,
        places: np.ndarray,
        zoom: np.ndarray,
        bodies: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """((n, 4, 2) px, (n,) whether the camera sees the face) of a face whose body stands at bodies (n, 4, 4)."""
        axes = _axes(face)
        half = cube.side / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
        corners = self.fault.printed(cube, face, half) @ axes.T + axes[:, 2] * cube.edge / 2
        seat = self.fault.placed(cube)
        world = bodies @ seat
        points = np.einsum("nij,kj->nki", world[:, :3, :3], corners) + world[:, None, :3, 3]
        outward, towards = world[:, :3, :3] @ axes[:, 2], places[:, :3, 3] - points.mean(axis=1)
        seen = np.einsum("ni,ni->n", outward, towards) > STEEPEST * np.linalg.norm(towards, axis=1)
        own = np.einsum("nji,nkj->nki", places[:, :3, :3], points - places[:, None, :3, 3])
        own = self.fault.bent(number, own)
        x, y = own[..., 0] / own[..., 2], own[..., 1] / own[..., 2]
        k1, k2, p1, p2, k3 = camera.lens
        r = x * x + y * y
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        bent = np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x), y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y],
            axis=-1,
        )
        uv = camera.focal * zoom[:, None] * bent + camera.middle
        return self.fault.warped(number, uv), seen

    def _rolled(
        self,
        uv: np.ndarray,
        seen: np.ndarray,
        squares: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
        bodies_at: Callable[[np.ndarray], np.ndarray],
    ) -> np.ndarray:
        """(n, 4, 2) px of corners that are exposed when their row is, of those uv seen together; seen : (n,) whether
        the face is; squares : as `_squares`, of bodies.
        """
        for _ in range(ROUNDS):
            late = np.where(seen[:, None], (uv[..., 1] - HIGH / 2) * self.fault.row_time, 0.0)
            uv = np.stack([squares(bodies_at(late[:, corner]))[0][:, corner] for corner in range(4)], axis=1)
        return uv


def _axes(face: int) -> np.ndarray:
    """(3, 3) columns right, up and out of a face in its cube, seen from outside: up is +z at the sides and +y on
    top.
    """
    out = np.zeros(3)
    out["xxyyzz".index(FACES[face][1]) // 2] = 1 if FACES[face][0] == "+" else -1
    up = np.array([0.0, 1, 0]) if FACES[face][1] == "z" else np.array([0.0, 0, 1])
    return np.stack([np.cross(up, out), up, out], axis=1)


def looking(name: str, place: np.ndarray, at: np.ndarray, focal: float, lens: np.ndarray) -> Camera:
    """A Camera at place (3,) that looks at a point (3,), its y downwards."""
    z = (at - place) / np.linalg.norm(at - place)
    x = np.cross(z, [0.0, 0, 1])
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return Camera(name, out, focal, np.array([(WIDE - 1) / 2, (HIGH - 1) / 2]), lens)


def watching(radius: float, height: float, fault: Sight, sigma: float, rng: np.random.Generator) -> CameraSet:
    """CameraSet of three cameras about a platform of a radius (m) at a height (m): two cubes on it, two on the base."""
    cubes = []
    for k in range(4):
        moves, edge = k < 2, 0.28 * radius
        angle, far = np.pi * k + (0.4 if moves else 1.9), (0.4 if moves else 1.35) * radius
        place = np.eye(4)
        place[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
        place[:3, 3] = far * np.cos(angle), far * np.sin(angle), edge / 2
        cubes.append(Cube(f"{'P' if moves else 'B'}{k % 2 + 1}", moves, edge, 0.8 * edge, 6 * k, place))
    stated, cameras = [], []
    for k in range(3):
        angle = 2.1 * k + 0.7
        place = radius * np.array([4.2 * np.cos(angle), 4.2 * np.sin(angle), 0]) + np.array(
            [0, 0, height + 2.2 * radius]
        )
        camera = looking(f"cam{k}", place, np.array([0, 0, 0.7 * height]), 1650.0, np.array([-0.1, 0.05, 0, 0, 0]))
        stated.append(camera)
        off = displaced(camera.place[None], np.r_[rng.normal(0, 2e-3, 3), rng.normal(0, 2e-3, 3)][None])[0]
        cameras.append(
            replace(
                camera,
                place=off,
                focal=camera.focal * (1 + rng.normal(0, 3e-4)),
                middle=camera.middle + rng.normal(0, 1, 2),
                lens=camera.lens + rng.normal(0, 1, 5) * [1e-3, 1e-3, 1e-4, 1e-4, 0],
            )
        )
    return CameraSet(tuple(cameras), tuple(stated), tuple(cubes), sigma, fault)
