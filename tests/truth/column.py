"""An arm on an elastic column: the column bends as a cantilever under what the arm's links weigh; tilt sensors read.

Links are points of mass. Source: Euler and Bernoulli: a moment M at the head of a cantilever of length H turns it by
M H / (E I) and moves it by M H^2 / (2 E I).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.truth.kinematics import Arm

DOWN = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Column:
    """An arm on a column. masses : (k,) kg; centres : (k, 3) m in each joint's link; height : m; stiffness : N m^2,
    E I; mounts : {link: (3, 3) of the sensor in it}
    """

    arm: Arm
    masses: np.ndarray
    centres: np.ndarray
    height: float
    stiffness: float
    mounts: dict[int, np.ndarray]

    def head(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) of the column's head from where it is unbent, at joint values (n, k); its own load is not bent."""
        out = np.tile(np.eye(4), (len(values), 1, 1))
        for frame, mass, centre in zip(self.arm.frames(values)[1:], self.masses, self.centres):
            place = frame[:, :3, :3] @ centre + frame[:, :3, 3]
            moment = np.cross(place, mass * DOWN)
            out[:, :3, 3] += np.cross(moment, [0.0, 0.0, 1.0]) * self.height**2 / (2 * self.stiffness)
            out[:, :3, :3] += np.cross(moment[:, None], np.eye(3)).swapaxes(1, 2) * self.height / self.stiffness
        u, _, v = np.linalg.svd(out[:, :3, :3])
        out[:, :3, :3] = u @ v
        return out

    def forward(self, values: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses of the hand."""
        return self.head(values) @ self.arm.forward(values)

    def read(self, values: np.ndarray, sigma: float, rng: np.random.Generator) -> dict[int, np.ndarray]:
        """{link: (n, 2) rad} that its sensor shows: an angle's sine is what the axis has of the vertical."""
        head, frames, out = self.head(values), self.arm.frames(values), {}
        for link, mount in self.mounts.items():
            axes = head[:, :3, :3] @ frames[link][:, :3, :3] @ mount
            out[link] = np.arcsin(axes[:, 2, :2]) + rng.normal(0, sigma, (len(values), 2))
        return out


def standing_on_a_column(arm: Arm, lean: float, mounts: dict[int, np.ndarray], rng: np.random.Generator) -> Column:
    """A column that leans by about `lean` rad (RMS) at random postures of an arm."""
    masses = np.array([12.0, 9.0, 6.0, 3.0, 2.0, 4.0])[: arm.width]
    centres = rng.normal(0, 0.04, (arm.width, 3))
    turned = {link: mount @ Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix() for link, mount in mounts.items()}
    column = Column(arm, masses, centres, 0.9, 1e5, turned)
    q = rng.uniform(*arm.ranges.T, (200, arm.width))
    size = np.linalg.norm(column.head(q)[:, :3, 2] - [0, 0, 1], axis=1)
    return Column(arm, masses, centres, 0.9, 1e5 * float(np.sqrt((size**2).mean())) / lean, turned)


def least_position_error(
    column: Column, seen: np.ndarray, new: np.ndarray, sigma: float, tilt_sigma: float, mount_sigma: float
) -> float:
    """m, Cramer-Rao: RMS error of positions at `new` (m, k) that nobody can beat who saw positions at `seen` (n, k).

    sigma : m, of a position's coordinate; tilt_sigma : rad, of each angle, 0 without sensors; mount_sigma : rad
    Unknown are the figures of all rows, where arm and hand stand, what the links weigh, the column's bending and how
    the sensors are mounted, each to within what a maker's figure may be wrong by. Jacobians are differences.
    """
    arm, k = column.arm, column.arm.width
    sizes = np.r_[
        np.tile([5e-3, 5e-3, 2e-2, 2e-2, 2e-2], k),  # d, a, alpha, tilt, zero of each row
        [5e-3] * 3, [2e-2] * 3, [5e-3] * 3,  # where the base stands, how it is turned, where the target sits
        [20.0] * k, [5.0] * (3 * k), 0.5,  # masses, mass moments, depth of the pivot
        [0.02] * 3, [mount_sigma] * (3 * len(column.mounts)),  # gravity and the sensors
    ]  # fmt: skip

    def moved(x: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, base, shift, hand, mass, moments, depth, down, mounts = np.split(
            x, np.cumsum([5 * k, 3, 3, 3, k, 3 * k, 1, 3])
        )
        own = rows.reshape(k, 5)
        figures = arm.rows + np.column_stack([np.zeros(k), own[:, :3]])
        changed = Arm(figures, arm.slides, arm.zeros + own[:, 4], arm.ranges, arm.tilts + own[:, 3])
        frames = changed.frames(q)
        turn = np.zeros((len(q), 3))
        for i, frame in enumerate(frames[1:]):
            weight = column.masses[i] + mass[i]
            place = frame[:, :3, :3] @ (column.masses[i] * column.centres[i] + moments[3 * i : 3 * i + 3])
            turn += np.cross(place + weight * frame[:, :3, 3], DOWN) * column.height / column.stiffness
        whole = Rotation.from_rotvec(shift)
        hands = frames[-1][:, :3, :3] @ hand + frames[-1][:, :3, 3]
        place = hands + np.cross(turn, hands + [0, 0, column.height / 2 + depth[0]])
        angles = []
        for number, (link, mount) in enumerate(column.mounts.items()):
            own_mount = mount @ Rotation.from_rotvec(mounts[3 * number : 3 * number + 3]).as_matrix()
            axes = Rotation.from_rotvec(turn).as_matrix() @ frames[link][:, :3, :3] @ own_mount
            axes = Rotation.from_rotvec(shift + down).as_matrix() @ axes
            angles.append(np.arcsin(np.clip(axes[:, 2, :2], -1, 1)))
        return whole.apply(place) + base, np.stack(angles, axis=1)

    def columns(q: np.ndarray) -> list[np.ndarray]:
        steps = np.diag(1e-4 * sizes)
        ends = [[moved(sign * step, q) for sign in (1, -1)] for step in steps]
        return [np.stack([(up[part] - down[part]).ravel() / 2e-4 for up, down in ends], axis=1) for part in (0, 1)]

    place, tilted = columns(seen)
    information = np.eye(len(sizes)) + place.T @ place / sigma**2
    if tilt_sigma:
        information += tilted.T @ tilted / tilt_sigma**2
    fresh = columns(new)[0]
    return float(np.sqrt(np.einsum("ij,ji->", fresh, np.linalg.solve(information, fresh.T)) / len(new)))
