"""Ambiguous poses resolved, and flipped poses found, by the poses of neighbouring frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_types import Floats

FAR = 0.5  # s to the frame before or after, beyond which it says nothing
AROUND = 20  # frames looked at on either side
MARGIN = 2.0  # times what nine in ten solved frames miss their neighbours by
WORSE = 3.0  # times as far as the best the second best must lie
LEAST = np.radians(2.0)  # whatever is closer to its neighbours than this is close
MOST = np.radians(45.0)  # neighbours that may miss by more say nothing
ENOUGH = 10  # solved frames between neighbours from which it is told how well neighbours predict

Poses = dict[int, Floats]  # {frame: T_world_body (4, 4)}


@dataclass(frozen=True, slots=True)
class Reach:
    """To what neighbours predict a body: rad/s^2 of the gap between the frames before and after, rad/s since the
    nearest.
    """

    between: float
    beside: float


def choose_poses_by_neighbours(solved_poses: Poses, candidates: dict[int, Sequence[Floats]], t: Floats) -> Poses:
    """Ambiguous poses chosen by neighbouring frames: {frame: T_world_body (4, 4)}.

    solved_poses : {frame: (4, 4)} solved; candidates : {frame: ((4, 4), ...)} candidates; t : (F,) s
    One candidate must lie within what neighbours predict solved frames to, and every other beyond it and WORSE times as
    far.
    A frame so decided is a neighbour in its turn.
    """
    reach, known = neighbour_rotation_scatter(solved_poses, t), dict(solved_poses)
    chosen: Poses = {}
    if reach is None:
        return chosen
    waiting = set(candidates)
    while waiting:
        fresh = {}
        for f in waiting:
            expected, limit = pose_from_neighbours(known, f, t, reach)
            if expected is None or not limit < MOST:
                continue
            miss = np.array([rotation_angle(expected, one) for one in candidates[f]])
            order = np.argsort(miss)
            if miss[order[0]] <= limit and (miss[order[1:]] > max(limit, WORSE * miss[order[0]])).all():
                fresh[f] = candidates[f][order[0]]
        chosen |= fresh
        known |= fresh
        waiting = {f for f in candidates if f not in chosen and any(abs(f - k) < AROUND for k in fresh)}
    return chosen


def rotation_outliers(solved_poses: Poses, t: Floats) -> dict[int, str]:
    """Rotation outliers {frame: reason} among solved poses (4, 4): flips against well-predicted neighbours."""
    reach = neighbour_rotation_scatter(solved_poses, t)
    odd: dict[int, str] = {}
    if reach is None:
        return odd
    for f, T in solved_poses.items():
        if None not in _near(solved_poses, f, t):
            expected, limit = pose_from_neighbours(solved_poses, f, t, reach)
            if expected is not None and rotation_angle(expected, T) > max(2 * limit, MOST):
                odd[f] = (
                    f"it turns by {np.degrees(rotation_angle(expected, T)):.0f} degrees against the frames "
                    "before and after"
                )
    return odd


def neighbour_rotation_scatter(solved_poses: Poses, t: Floats) -> Reach | None:
    """Scatter (Reach) of rotation about what neighbouring solved frames predict; None with too few.
    t : (F,) s
    """
    between, beside = [], []
    for f, T in solved_poses.items():
        before, after = _near(solved_poses, f, t)
        if before is not None and after is not None:
            between.append(rotation_angle(_between(solved_poses, before, after, f, t), T) / (t[after] - t[before]) ** 2)
            beside.append(rotation_angle(solved_poses[before], T) / (t[f] - t[before]))
    if len(between) < ENOUGH:
        return None
    return Reach(MARGIN * np.quantile(between, 0.9), MARGIN * np.quantile(beside, 0.9))


def pose_from_neighbours(solved_poses: Poses, f: int, t: Floats, scatter: Reach) -> tuple[Floats | None, float]:
    """((4, 4) pose of frame f from solved neighbours, rad that it may be off); (None, inf) without any."""
    before, after = _near(solved_poses, f, t)
    ways = [(scatter.beside * abs(t[f] - t[k]), k) for k in (before, after) if k is not None]
    limit, nearest = min(ways, default=(np.inf, None))
    if before is not None and after is not None and scatter.between * (t[after] - t[before]) ** 2 < limit:
        return _between(solved_poses, before, after, f, t), max(LEAST, scatter.between * (t[after] - t[before]) ** 2)
    return None if nearest is None else solved_poses.get(nearest), max(LEAST, limit)


def _near(found: Poses, f: int, t: Floats) -> list[int | None]:
    """The nearest solved frames before and after f within FAR, None where there is none."""
    last = len(t) - 1
    return [
        next(
            (
                k
                for k in range(f + way, min(max(f + way * AROUND, -1), last + 1), way)
                if k in found and abs(t[f] - t[k]) <= FAR
            ),
            None,
        )
        for way in (-1, 1)
    ]


def _between(found: Poses, before: int, after: int, f: int, t: Floats) -> Floats:
    """(4, 4) at frame f on an even way from one solved frame to another."""
    share, T_a, T_b = (t[f] - t[before]) / (t[after] - t[before]), found[before], found[after]
    turn = Rotation.from_matrix(T_a[:3, :3].T @ T_b[:3, :3]).as_rotvec()
    out = (1 - share) * T_a + share * T_b
    out[:3, :3] = T_a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    return out


def rotation_angle(a: Floats, b: Floats) -> float:
    """rad between the rotations of two poses (4, 4)."""
    return float(np.arccos(np.clip((np.einsum("ij,ij", a[:3, :3], b[:3, :3]) - 1) / 2, -1, 1)))
