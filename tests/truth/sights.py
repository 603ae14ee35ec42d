"""Faults of cameras, prints and targets, several laws each: sized in px, which is what they do to a corner."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.truth.camera_sets import HIGH, WIDE, Camera, Cube, Sight
from tests.truth.motion import REFERENCE, Conditions

MIDDLE = np.array([WIDE, HIGH]) / 2


@dataclass(frozen=True)
class Lens(Sight):
    """A lens that leaves its terms. camera; size : px at the image's edge; kind : 0 a seventh power of the radius, 1 a
    bump at `where` (2,) px
    """

    camera: int
    size: float
    kind: int
    where: np.ndarray

    def warped(self, number: int, uv: np.ndarray) -> np.ndarray:
        if number != self.camera:
            return uv
        if self.kind == 0:
            out = (uv - MIDDLE) / MIDDLE[0]
            return uv + self.size * out * (out**2).sum(axis=-1, keepdims=True) ** 3
        near = (uv - self.where) / 250.0
        return uv + 1.7 * self.size * near * np.exp(-(near**2).sum(axis=-1, keepdims=True))


@dataclass(frozen=True)
class Zooming(Sight):
    """Focal lengths follow the room: per_kelvin along u and along v."""

    per_kelvin: np.ndarray

    def zoom(self, number: int, t: np.ndarray, day: Conditions) -> np.ndarray:
        return 1 + (day.room_at(t) - REFERENCE)[:, None] * self.per_kelvin


@dataclass(frozen=True)
class Moving(Sight):
    """One camera's mount moves by a small motion (6,): at once at a moment, or creeping with two times. times : s, one
    or two
    """

    camera: int
    motion: np.ndarray
    times: tuple[float, ...]
    once: bool

    def standing(self, camera: Camera, number: int, t: np.ndarray) -> np.ndarray:
        if number != self.camera:
            return np.zeros((len(t), 6))
        if self.once:
            share = np.mean([t > moment for moment in self.times], axis=0)
        else:
            share = np.mean([1 - np.exp(-t / pace) for pace in self.times], axis=0)
        return share[:, None] * self.motion


@dataclass(frozen=True)
class Rolling(Sight):
    """Rows are exposed one after the other, in all cameras."""

    row_time: float


@dataclass(frozen=True)
class Window(Sight):
    """A plane glass before one camera: thickness m, of index 1.5; square : its normal in the camera's frame. Snell's
    law, ray by ray.
    """

    camera: int
    thickness: float
    square: np.ndarray

    def bent(self, number: int, points: np.ndarray) -> np.ndarray:
        if number != self.camera:
            return points
        shift = np.zeros_like(points)
        for _ in range(30):
            ray = points - shift
            ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
            cosine = ray @ self.square
            along = ray - cosine[..., None] * self.square  # of length sine
            inside = np.sqrt(1 - ((1 - cosine**2) / 1.5**2))
            shift = self.thickness * along * (1 / (1.5 * inside) - 1 / cosine)[..., None]
        return points - shift


@dataclass(frozen=True)
class Edges(Sight):
    """Every edge of the black moves inward by px: along the edge's normal in the image. slope : how much more at the
    image's edge
    """

    inward: float
    slope: float

    def bordered(self, number: int, squares: np.ndarray) -> np.ndarray:
        by = self.inward * (1 + self.slope * np.linalg.norm(squares.mean(axis=1) - MIDDLE, axis=1) / MIDDLE[0])
        lines = []
        for k in range(4):
            start, end = squares[:, k], squares[:, (k + 1) % 4]
            along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
            normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
            normal *= np.sign(((squares.mean(axis=1) - start) * normal).sum(axis=1))[:, None]
            lines.append((normal, (normal * start).sum(axis=1) + by))
        out = np.empty_like(squares)
        for k in range(4):
            (a, b), (c, d) = lines[k - 1], lines[k]
            out[:, k] = np.linalg.solve(np.stack([a, c], axis=1), np.stack([b, d], axis=1)[..., None])[..., 0]
        return out


@dataclass(frozen=True)
class Printed(Sight):
    """Prints are larger than stated by shares along their x and y, (2,)."""

    shares: np.ndarray

    def printed(self, cube: Cube, face: int, corners: np.ndarray) -> np.ndarray:
        return corners * (1 + np.r_[self.shares, 0])


@dataclass(frozen=True)
class Askew(Sight):
    """One face's marker sits off its place by (x, y, turn), m and rad, and may be lifted at one side by m."""

    cube: str
    face: int
    off: np.ndarray
    lifted: float

    def printed(self, cube: Cube, face: int, corners: np.ndarray) -> np.ndarray:
        if (cube.name, face) != (self.cube, self.face):
            return corners
        turned = corners @ Rotation.from_rotvec([0, 0, self.off[2]]).as_matrix().T + np.r_[self.off[:2], 0]
        return turned + np.outer(corners[:, 0] > 0, [0, 0, self.lifted])


@dataclass(frozen=True)
class Misplaced(Sight):
    """One cube stands off its stated place by a small motion (6,)."""

    cube: str
    motion: np.ndarray

    def placed(self, cube: Cube) -> np.ndarray:
        if cube.name != self.cube:
            return cube.place
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = Rotation.from_rotvec(self.motion[3:]).as_matrix(), self.motion[:3]
        return cube.place @ out


@dataclass(frozen=True)
class Swapped(Sight):
    """Two faces' markers are exchanged, or one is turned by quarter turns."""

    cube: str
    faces: tuple[int, int]
    turns: int

    def read(self, cube: Cube, face: int) -> tuple[int, int]:
        if cube.name != self.cube or face not in self.faces:
            return face, 0
        if self.turns:
            return face, self.turns if face == self.faces[0] else 0
        return self.faces[1 - self.faces.index(face)], 0


@dataclass(frozen=True)
class Scene:
    """What a fault of seeing is drawn from. px : its size; focal : px; far : m to what is seen; span : s; warmth : K;
    pace : m/s as it moves
    side : m of a marker"""

    px: float
    focal: float
    far: float
    span: float
    warmth: float
    pace: float
    side: float
    rng: np.random.Generator

    @property
    def metres(self) -> float:
        """The size in m at what is seen."""
        return self.px * self.far / self.focal

    @property
    def larger(self) -> float:
        """Share by which a print of the size is larger, 5e-3 at the most."""
        return min(2 * self.metres / self.side, 5e-3)

    @property
    def zooms(self) -> float:
        """1/K, of a focal length that changes by the size at 250 px as the room warms, 4e-4 at the most."""
        return min(self.px / 250 / (0.4 * self.warmth), 4e-4)

    @property
    def camera(self) -> int:
        """One of the three cameras."""
        return int(self.rng.integers(3))

    @property
    def mount(self) -> np.ndarray:
        """(6,) a small motion of a camera that moves the image by about the size."""
        turn = self.rng.normal(size=3)
        return np.r_[np.zeros(3), turn / np.linalg.norm(turn[:2]) * self.px / self.focal]


def _window(s: Scene) -> list[Sight]:
    thick = 3 * s.metres / 0.05
    return [
        Window(s.camera, thick, np.array([0, 0, 1.0])),
        Window(s.camera, min(thick, 0.03), np.array([np.sin(0.4), 0, np.cos(0.4)])),
    ]


def _askew(s: Scene) -> list[Sight]:
    off = s.rng.normal(size=3) * s.metres * np.array([1, 1, 2 / s.side])
    return [Askew("P1", 4, off, 0.0), Askew("P2", int(s.rng.integers(4)), off, 2 * s.metres)]


def _misplaced(s: Scene) -> list[Sight]:
    motion = s.rng.normal(size=6) * s.metres * np.r_[1, 1, 1, 2 / s.side, 2 / s.side, 2 / s.side]
    return [Misplaced("P1", motion), Misplaced("B2", motion)]


SIGHTS: dict[str, Callable[[Scene], list[Sight]]] = {
    "lens_distortion": lambda s: [
        Lens(s.camera, 3 * s.px, 0, MIDDLE),
        Lens(s.camera, 3 * s.px, 1, MIDDLE + s.rng.uniform(-150, 150, 2)),
    ],
    "focal_drift": lambda s: [Zooming(np.full(2, s.zooms)), Zooming(np.array([1.2, 0.8]) * s.zooms)],
    "camera_drift": lambda s: [
        Moving(s.camera, 2 * s.mount, (s.span / 4, s.span), False),
        Moving(s.camera, 2 * s.mount, (s.span * 5,), False),
    ],
    "camera_bump": lambda s: [
        Moving(s.camera, s.mount, (s.span * s.rng.uniform(0.3, 0.7),), True),
        Moving(s.camera, s.mount, (s.span * 0.3, s.span * 0.6), True),
    ],
    "rolling_shutter": lambda s: [Rolling(min(s.metres / s.pace / 200, 3e-5))],
    "refraction": _window,
    "edge_bias": lambda s: [Edges(s.px, 0.0), Edges(0.8 * s.px, 0.5)],
    "print_scale": lambda s: [Printed(np.full(2, s.larger)), Printed(np.array([1.2, 0.8]) * s.larger)],
    "face_misplacement": _askew,
    "cube_misplacement": _misplaced,
    "marker_swap": lambda s: [Swapped("P1", (0, 2), 0), Swapped("P2", (4, 1), 1)],
}
