"""The machines' own kinematics: a platform on six struts, two struts to a hinge, an arm by Denavit-Hartenberg rows, and
one upon the other.

Every machine has `width` (axes), `ranges` (width, 2), `names` (columns of commands.csv), `forward(values)` and
`inverse(poses, guess)`.
The values are what the controller is given: zeros of the axes are part of the machine.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.truth.rigid import errors, matrices, rows_of


@dataclass(frozen=True)
class SixStruts:
    """base, plate : (6, 3) m, joint centres in their plates' frames; zeros : (6,) m, real length less the commanded one
    ranges : (6, 2) m of commands; height : m, of the platform at home, level"""

    base: np.ndarray
    plate: np.ndarray
    zeros: np.ndarray
    ranges: np.ndarray
    height: float

    width = 6
    prefix = "l"

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of commands.csv."""
        return tuple(f"l{i + 1}" for i in range(6))

    def legs(self, poses: np.ndarray) -> np.ndarray:
        """(n, 6, 3) m, from base joint to platform joint, in the base, at poses (n, 4, 4)."""
        return np.einsum("nij,kj->nki", poses[:, :3, :3], self.plate) + poses[:, None, :3, 3] - self.base

    def inverse(self, poses: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """(n, 6) m commands that stand at poses (n, 4, 4)."""
        return np.linalg.norm(self.legs(poses), axis=2) - self.zeros

    def rates(self, poses: np.ndarray) -> np.ndarray:
        """(n, 6, 6) change of the lengths with (translation, rotation) of the platform about its own origin, in base
        axes.
        """
        legs = self.legs(poses)
        u = legs / np.linalg.norm(legs, axis=2, keepdims=True)
        arms = np.einsum("nij,kj->nki", poses[:, :3, :3], self.plate)
        return np.concatenate([u, np.cross(arms, u)], axis=2)

    def forward(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses of commands (n, 6) m: Newton's steps with rotations in base axes, from home. Raises
        ArithmeticError.
        """
        goal = np.atleast_2d(values) + self.zeros
        poses = np.tile(matrices(np.array([[0, 0, self.height, 0, 0, 0]])), (len(goal), 1, 1))
        for _ in range(60):
            miss = goal - np.linalg.norm(self.legs(poses), axis=2)
            if np.abs(miss).max() < 1e-14:
                return poses
            step = np.linalg.solve(self.rates(poses), miss[..., None])[..., 0]
            step /= np.maximum(1.0, np.abs(step).max(axis=1) / 0.2)[:, None]
            poses[:, :3, 3] += step[:, :3]
            poses[:, :3, :3] = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ poses[:, :3, :3]
        if np.abs(miss).max() > 1e-12:
            raise ArithmeticError(
                f"no pose for {(np.abs(miss).max(axis=1) > 1e-12).sum()} of {len(goal)} commands, "
                f"{np.abs(miss).max():.3g} m left"
            )
        return poses


@dataclass(frozen=True)
class Hinge:
    """Two struts to one hinge in the plane z = 0. base : (2, 2) m; zeros : (2,) m; ranges : (2, 2) m"""

    base: np.ndarray
    zeros: np.ndarray
    ranges: np.ndarray

    width = 2
    prefix = "l"
    names = ("l1", "l2")

    def inverse(self, poses: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """(n, 2) m commands at poses (n, 4, 4)."""
        return np.stack([np.hypot(*(poses[:, :2, 3] - joint).T) for joint in self.base], axis=1) - self.zeros

    def forward(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses, not turned, of commands (n, 2) m: by the angle at the first base joint (law of cosines)."""
        first, second = (np.atleast_2d(values) + self.zeros).T
        line = self.base[1] - self.base[0]
        span = np.hypot(*line)
        angle = np.arctan2(line[1], line[0]) + np.arccos((first**2 + span**2 - second**2) / (2 * first * span))
        rows = np.zeros((len(first), 6))
        rows[:, 0], rows[:, 1] = self.base[0, 0] + first * np.cos(angle), self.base[0, 1] + first * np.sin(angle)
        return matrices(rows)


@dataclass(frozen=True)
class Arm:
    """rows : (k, 4) theta rad, d m, a m, alpha rad, distal; slides : (k,) whether a joint is a slide; zeros : (k,) rad
    or m
    ranges : (k, 2) of commands; tilts : (k,) rad, Hayati's turn about y behind each row"""

    rows: np.ndarray
    slides: np.ndarray
    zeros: np.ndarray
    ranges: np.ndarray
    tilts: np.ndarray

    prefix = "q"

    @property
    def width(self) -> int:
        """Joints."""
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of commands.csv."""
        return tuple(f"q{i + 1}" for i in range(self.width))

    def frames(self, values: np.ndarray) -> list[np.ndarray]:
        """(n, 4, 4) of each frame in turn, the base's first, at commands (n, k)."""
        values = np.atleast_2d(values) + self.zeros
        out = [np.tile(np.eye(4), (len(values), 1, 1))]
        for i, (theta, d, a, alpha) in enumerate(self.rows):
            about = theta + (0 if self.slides[i] else values[:, i])
            along = d + (values[:, i] if self.slides[i] else 0)
            link = np.zeros((len(values), 4, 4))
            c, s, ca, sa = np.cos(about), np.sin(about), np.cos(alpha), np.sin(alpha)
            link[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=-1) + np.zeros((len(values), 1))
            link[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=-1) + np.zeros((len(values), 1))
            link[:, 2, 1], link[:, 2, 2], link[:, 2, 3], link[:, 3, 3] = sa, ca, along, 1
            link[:, :3, :3] = link[:, :3, :3] @ Rotation.from_rotvec([0, self.tilts[i], 0]).as_matrix()
            out.append(out[-1] @ link)
        return out

    def forward(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses of the hand in the base at commands (n, k)."""
        return self.frames(values)[-1]

    def inverse(self, poses: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """(n, k) commands at poses (n, 4, 4), each sought from guess (n, k), the middle by default."""
        return _sought(self, poses, guess)


@dataclass(frozen=True)
class Chain:
    """stages : machines, the first on the base, each next one on the platform of the one before."""

    stages: tuple["Machine", ...]

    prefix = "s"

    @property
    def width(self) -> int:
        """Axes of all stages."""
        return sum(stage.width for stage in self.stages)

    @property
    def ranges(self) -> np.ndarray:
        """(width, 2) of commands."""
        return np.vstack([stage.ranges for stage in self.stages])

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of commands.csv."""
        return tuple(f"s{k + 1}{name}" for k, stage in enumerate(self.stages) for name in stage.names)

    def forward(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses of the last platform in the base at commands (n, width)."""
        values, out, start = np.atleast_2d(values), np.eye(4), 0
        for stage in self.stages:
            out = out @ stage.forward(values[:, start : start + stage.width])
            start += stage.width
        return out

    def inverse(self, poses: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """(n, width) commands at poses (n, 4, 4), each sought from guess (n, width), the middle by default."""
        return _sought(self, poses, guess)


Machine = SixStruts | Hinge | Arm | Chain


def _sought(machine: Arm | Chain, poses: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
    """Commands at poses, by Gauss and Newton's steps of least length from guess. Raises ArithmeticError where more than
    1e-10 is left.
    """
    values = np.tile(machine.ranges.mean(axis=1), (len(poses), 1)) if guess is None else np.array(guess, float)
    small = 1e-6 * np.eye(machine.width)
    for _ in range(60):
        miss = errors(machine.forward(values), poses)
        if np.abs(miss).max() < 1e-13:
            break
        slopes = [
            (errors(machine.forward(values + d), poses) - errors(machine.forward(values - d), poses)) / 2e-6
            for d in small
        ]
        step = (np.linalg.pinv(np.stack(slopes, axis=2)) @ miss[..., None])[..., 0]
        values = values - step / np.maximum(1.0, np.abs(step).max(axis=1) / 0.3)[:, None]
    left = np.abs(errors(machine.forward(values), poses)).max(axis=1)
    if left.max() > 1e-10:
        raise ArithmeticError(f"pose {rows_of(poses)[left.argmax()].tolist()} is out of reach: {left.max():.3g} left")
    return values
