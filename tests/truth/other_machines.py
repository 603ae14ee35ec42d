"""Machines of kinds that nobody ships, by a second writer: a linear delta, a hexaglide, a platform on rotary cranks.

Forward kinematics alone: the delta by the intersection of three spheres, the others by solving the squared lengths of
their rods for the pose. Nothing here computes axes from a pose.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root
from scipy.stats import qmc

from tests.truth.rigid import displaced, errors, matrices

LENGTH, ANGLE = 3e-4, 6e-4  # m, rad; standard deviation of the truth about the owner's figures
Figures = dict[str, np.ndarray]


@dataclass(frozen=True)
class OtherMachine:
    """name; figures : {name: array} m and rad; angles : names of those in rad; ranges : (axes, 2); freedoms : of a
    pose's x y z rx ry rz; poses : figures, values (n, axes) -> (n, 4, 4)"""

    name: str
    figures: Figures
    angles: tuple[str, ...]
    ranges: np.ndarray
    freedoms: tuple[int, ...]
    poses: Callable[[Figures, np.ndarray], np.ndarray]

    def forward(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) where the platform stands at values (n, axes)."""
        return self.poses(self.figures, values)

    def secret(self, rng: np.random.Generator) -> "OtherMachine":
        """The machine as it really is: every figure off by LENGTH or ANGLE."""
        return self.with_figures(self.flat() + self.sizes() * rng.normal(size=len(self.sizes())))

    def flat(self) -> np.ndarray:
        """(p,) all its figures."""
        return np.concatenate([one.ravel() for one in self.figures.values()])

    def sizes(self) -> np.ndarray:
        """(p,) by how much each may be off."""
        return np.concatenate(
            [np.full(one.size, ANGLE if name in self.angles else LENGTH) for name, one in self.figures.items()]
        )

    def with_figures(self, flat: np.ndarray) -> "OtherMachine":
        """The machine with all its figures (p,)."""
        out, at = {}, 0
        for name, one in self.figures.items():
            out[name] = flat[at : at + one.size].reshape(one.shape)
            at += one.size
        return OtherMachine(self.name, out, self.angles, self.ranges, self.freedoms, self.poses)

    def rates(self, values: np.ndarray) -> np.ndarray:
        """(n, 6, p) change of the poses with the figures, by differences, in the platform's own frame."""
        flat, step = self.flat(), 1e-5
        columns = []
        for k in range(len(flat)):
            ends = [self.with_figures(flat + side * step * np.eye(len(flat))[k]).forward(values) for side in (1, -1)]
            columns.append(errors(*ends) / (2 * step))
        return np.stack(columns, axis=-1)

    def bound(self, values: np.ndarray, sigma: tuple[float, float], at: np.ndarray) -> float:
        """m, Cramer-Rao bound of the RMS position error at values (m, axes), of any estimate without bias of the
        figures from poses measured at values (n, axes) with sigma (m, rad).
        """
        some = list(self.freedoms)
        noise = np.repeat(sigma, 3)[some]
        J = (self.rates(values)[:, some] / noise[:, None] * self.sizes()).reshape(-1, len(self.sizes()))
        values_, vectors = np.linalg.eigh(J.T @ J)
        determined = values_ > 1e-7 * values_[-1]  # the rest moves no pose
        half = vectors[:, determined] / np.sqrt(values_[determined])
        rates = self.rates(at)[:, :3] * self.sizes() @ half
        return float(np.sqrt((rates**2).sum(axis=(1, 2)).mean()))


def middle(machine: OtherMachine, share: float, unit: np.ndarray) -> np.ndarray:
    """(n, axes) values in the middle share of the ranges at points (n, axes) of the unit cube."""
    return machine.ranges.mean(axis=1) + share * np.ptp(machine.ranges, axis=1) * (unit - 0.5)


def scattered(machine: OtherMachine, count: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """(count, axes) values spread over the middle share of the ranges."""
    return middle(machine, share, qmc.Halton(len(machine.ranges), rng=rng).random(count))


def grid(machine: OtherMachine, parts: int, share: float) -> np.ndarray:
    """(levels^axes, axes) values of a grid over the middle share of the ranges."""
    levels = np.linspace(0, 1, parts + 1)
    every = np.stack(np.meshgrid(*[levels] * len(machine.ranges), indexing="ij"), axis=-1)
    return middle(machine, share, every.reshape(-1, len(machine.ranges)))


def measured(poses: np.ndarray, sigma: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """(n, 4, 4) the poses as an instrument of sigma (m, rad) sees them."""
    return displaced(poses, np.repeat(sigma, 3) * rng.normal(size=(len(poses), 6)))


def _delta(figures: Figures, values: np.ndarray) -> np.ndarray:
    """By trilateration: the platform's origin lies on a sphere about each carriage drawn in by its joint."""
    out = np.tile(np.eye(4), (len(values), 1, 1))
    for k, q in enumerate(values):
        a, b, c = np.column_stack([figures["rails"] - figures["joints"], q + figures["zeros"]])
        ra, rb, rc = figures["bars"] ** 2
        ex = (b - a) / np.linalg.norm(b - a)
        i = ex @ (c - a)
        ey = c - a - i * ex
        ey /= np.linalg.norm(ey)
        d, j = np.linalg.norm(b - a), ey @ (c - a)
        x = (ra - rb + d**2) / (2 * d)
        y = (ra - rc + i**2 + j**2) / (2 * j) - i / j * x
        up = np.cross(ex, ey) * np.sign(np.cross(ex, ey)[2])
        out[k, :3, 3] = a + x * ex + y * ey - np.sqrt(ra - x**2 - y**2) * up
    return out


def _on_rods(tips: np.ndarray, joints: np.ndarray, rods: np.ndarray, home: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses at which rods (6,) reach from tips (n, 6, 3) to the platform's joints (6, 3), near home (6,)."""
    rows = []
    for own in tips:

        def left(row: np.ndarray, own: np.ndarray = own) -> np.ndarray:
            pose = matrices(row)[0]
            return ((joints @ pose[:3, :3].T + pose[:3, 3] - own) ** 2).sum(axis=1) - rods**2

        found = root(left, home, tol=1e-14)
        assert np.abs(found.fun).max() < 1e-11, found.message
        rows.append(found.x)
    return matrices(np.array(rows))


def _hexaglide(figures: Figures, values: np.ndarray) -> np.ndarray:
    rail = np.column_stack([np.ones(6), figures["directions"]])
    rail /= np.linalg.norm(rail, axis=1)[:, None]
    tips = figures["rails"] + (values + figures["zeros"])[..., None] * rail
    return _on_rods(tips, figures["joints"], figures["struts"], np.array([0, 0, 0.25, 0, 0, 0.0]))


def _cranks(figures: Figures, values: np.ndarray) -> np.ndarray:
    turn, to = values + figures["zeros"], figures["azimuths"]
    level = figures["arms"] * np.cos(turn)
    tips = figures["pivots"] + np.stack([level * np.cos(to), level * np.sin(to), figures["arms"] * np.sin(turn)], -1)
    return _on_rods(tips, figures["joints"], figures["rods"], np.array([0, 0, 0.25, 0, 0, 0.0]))


def _circle(radius: float, degrees: list[float]) -> np.ndarray:
    angle = np.deg2rad(degrees)
    return radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])


def linear_delta() -> OtherMachine:
    """As its owner believes it."""
    figures = {
        "rails": _circle(0.20, [90, 210, 330])[:, :2],
        "bars": np.full(3, 0.30),
        "zeros": np.zeros(3),
        "joints": _circle(0.05, [90, 210, 330])[:, :2],
    }
    return OtherMachine("delta", figures, (), np.tile([0.27, 0.43], (3, 1)), (0, 1, 2), _delta)


def hexaglide() -> OtherMachine:
    """As its owner believes it."""
    rails = np.array(
        [[-0.2, 0.04, 0], [0.3, 0.26, 0], [0.21, 0.22, 0], [-0.2, -0.04, 0], [0.3, -0.26, 0], [0.21, -0.22, 0]]
    )
    joints = _circle(0.12, [80, 15, 120, -80, -15, -120])
    figures = {
        "rails": rails,
        "directions": np.zeros((6, 2)),
        "zeros": np.zeros(6),
        "struts": np.sqrt(((joints - rails) ** 2).sum(axis=1) + 0.25**2),
        "joints": joints,
    }
    return OtherMachine(
        "hexaglide", figures, ("directions",), np.tile([-0.06, 0.06], (6, 1)), (0, 1, 2, 3, 4, 5), _hexaglide
    )


def rotary_cranks() -> OtherMachine:
    """As its owner believes it."""
    pivots, joints = (_circle(0.20, [25, 95, 145, 215, 265, 335]), _circle(0.14, [50, 70, 170, 190, 290, 310]))
    to = np.deg2rad([25 - 90, 95 + 90, 145 - 90, 215 + 90, 265 - 90, 335 + 90])
    tips = pivots + 0.06 * np.column_stack([np.cos(to), np.sin(to), 0 * to])
    figures = {
        "pivots": pivots,
        "azimuths": to,
        "arms": np.full(6, 0.06),
        "rods": np.sqrt(((joints - tips) ** 2).sum(axis=1) + 0.25**2),
        "joints": joints,
        "zeros": np.zeros(6),
    }
    return OtherMachine(
        "cranks", figures, ("azimuths", "zeros"), np.tile([-0.7, 0.7], (6, 1)), (0, 1, 2, 3, 4, 5), _cranks
    )


OTHERS = {"delta": linear_delta, "hexaglide": hexaglide, "cranks": rotary_cranks}
