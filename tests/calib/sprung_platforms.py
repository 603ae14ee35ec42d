"""An independent truth of platforms on more than six elastic struts: where they come to rest, what their struts bear,
and how well any calibration can know them.

Lengths, equilibria and derivatives are worked out here, by other means than the package's: poses are rows x y z and a
rotation vector, an equilibrium is the least elastic energy, derivatives are differences.
"""

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

OFF = 3e-4  # m, standard deviation of every coordinate and zero from where its owner has it
STEP = 1e-6  # m or rad, of differences
RADIUS, PLATE, HEIGHT = 0.3, 0.2, 0.45  # m
FOLLOWERS = {7: (3,), 8: (3, 8)}  # numbers, from 1, of struts that are released while poses are measured


@dataclass(frozen=True)
class SprungPlatform:
    """base, plate : (s, 3) m, joints in their plates' frames; zeros : (s,) m; all struts have one stiffness."""

    base: np.ndarray
    plate: np.ndarray
    zeros: np.ndarray

    def lengths(self, rows: np.ndarray) -> np.ndarray:
        """(n, s) m, of struts without force at poses (n, 6) m and rad."""
        turned = np.stack([Rotation.from_rotvec(row[3:]).apply(self.plate) for row in rows])
        return np.sqrt(((turned + rows[:, None, :3] - self.base) ** 2).sum(axis=2)) - self.zeros

    def rests(self, commanded: np.ndarray) -> np.ndarray:
        """(n, 6) m and rad, poses of least elastic energy at commanded lengths (n, s) m."""
        home = np.array([0, 0, HEIGHT, 0, 0, 0])

        def rest(goal: np.ndarray) -> np.ndarray:
            found = scipy.optimize.least_squares(
                lambda row: 1e3 * (self.lengths(row[None])[0] - goal), home, xtol=1e-15, ftol=1e-15, gtol=1e-15
            )
            return np.asarray(found.x)

        return np.array([rest(goal) for goal in commanded])

    def driven_by(self, some: list[int]) -> "SprungPlatform":
        """The platform on some of its struts, from 0."""
        return SprungPlatform(self.base[some], self.plate[some], self.zeros[some])

    def moved(self, p: np.ndarray) -> "SprungPlatform":
        """The platform whose base joints, platform joints and zeros are larger by (7 s,) m, in this order."""
        base, plate, zeros = np.split(p, [self.base.size, 2 * self.base.size])
        return SprungPlatform(self.base + base.reshape(-1, 3), self.plate + plate.reshape(-1, 3), self.zeros + zeros)

    def by_pose(self, rows: np.ndarray) -> np.ndarray:
        """(n, s, 6) change of the lengths with a motion along and about the platform's own axes, m and rad."""
        parts = [self.lengths(in_own_axes(rows, side * STEP * unit)) for unit in np.eye(6) for side in (1, -1)]
        return np.stack([(a - b) / (2 * STEP) for a, b in zip(parts[::2], parts[1::2])], axis=2)

    def by_parameters(self, rows: np.ndarray) -> np.ndarray:
        """(n, s, 7 s) change of the lengths with the parameters of `moved`."""
        unit = np.eye(7 * len(self.zeros))
        return np.stack(
            [(self.moved(STEP * p).lengths(rows) - self.moved(-STEP * p).lengths(rows)) / (2 * STEP) for p in unit],
            axis=2,
        )

    def bound(self, rows: np.ndarray, pose_sigma: np.ndarray, strut_sigma: float) -> np.ndarray:
        """(7 s, 7 s) m^2, least covariance that poses (n, 6) and all lengths leave of the parameters (Cramer and Rao,
        with what is known beforehand: van Trees), each pose among the unknowns.
        """
        to_pose, to_own = self.by_pose(rows) / strut_sigma, self.by_parameters(rows) / strut_sigma
        information = np.eye(to_own.shape[2]) / OFF**2
        for A, B in zip(to_pose, to_own):
            pose = A.T @ A + np.diag(pose_sigma**-2.0)
            information += B.T @ B - B.T @ A @ np.linalg.solve(pose, A.T @ B)
        return np.linalg.inv(information)

    def pose_bound(self, rows: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
        """(m, rad) RMS errors at poses (n, 6) by parameters of a covariance."""
        J = np.linalg.pinv(self.by_pose(rows)) @ self.by_parameters(rows)
        C = J @ covariance @ np.swapaxes(J, 1, 2)
        place, turn = (np.trace(C[:, part, part], axis1=1, axis2=2).mean() for part in (slice(3), slice(3, 6)))
        return float(np.sqrt(place)), float(np.sqrt(turn))


def in_own_axes(rows: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Pose rows (n, 6) moved along and about the platform's own axes by (6,) or (n, 6) m and rad."""
    R, motion = Rotation.from_rotvec(rows[:, 3:]), motion + np.zeros(rows.shape)
    return np.hstack([rows[:, :3] + R.apply(motion[:, :3]), (R * Rotation.from_rotvec(motion[:, 3:])).as_rotvec()])


def stated(struts: int) -> SprungPlatform:
    """A platform on seven or eight struts as its owner states it, in pairs on two circles."""

    def ring(radius: float, half: float) -> np.ndarray:
        angles = [np.pi / 2 * k + side * half for k in range(4) for side in (-1, 1)]
        return radius * np.array([[np.cos(angle), np.sin(angle), 0.0] for angle in angles])[:struts]

    return SprungPlatform(ring(RADIUS, 0.15), ring(PLATE, 0.65), np.zeros(struts))


def drawn(struts: int, rng: np.random.Generator) -> SprungPlatform:
    """The same as it truly is."""
    return stated(struts).moved(OFF * rng.normal(size=7 * struts))


def somewhere(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 6) m and rad, poses within reach."""
    return np.array([0, 0, HEIGHT, 0, 0, 0]) + [0.03, 0.03, 0.02, 0.1, 0.1, 0.2] * rng.uniform(-1, 1, (count, 6))


@dataclass(frozen=True)
class Measured:
    """rows : (n, 6) true poses; lengths : (n, s) m, commanded of driven struts and read of followers; seen : (n, 6)
    poses as measured
    """

    rows: np.ndarray
    lengths: np.ndarray
    seen: np.ndarray


def measured(
    true: SprungPlatform, count: int, pose_sigma: np.ndarray, strut_sigma: float, rng: np.random.Generator
) -> Measured:
    """What is recorded of `count` poses while six struts drive the platform and the others follow it without force."""
    struts = len(true.zeros)
    followers = [one - 1 for one in FOLLOWERS[struts]]
    driven = [i for i in range(struts) if i not in followers]
    lengths = stated(struts).lengths(somewhere(count, rng))
    scatter = strut_sigma * rng.normal(size=lengths.shape)
    rows = true.driven_by(driven).rests((lengths + scatter)[:, driven])
    lengths[:, followers] = (true.lengths(rows) - scatter)[:, followers]
    return Measured(rows, lengths, in_own_axes(rows, pose_sigma * rng.normal(size=rows.shape)))
