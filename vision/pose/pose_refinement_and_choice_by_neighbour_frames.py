"""Refinement of a pose from its corners, and choice between ambiguous poses by neighbouring frames.

Of one pose from its corners; ambiguity is decided by the frames before and after.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.model.pose import rotate_in_place

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
    adjacent: float


def choose_poses_by_neighbours(solved_poses: Poses, candidates: dict[int, Sequence[Floats]], t: Floats) -> Poses:
    """Ambiguous poses chosen by neighbouring frames.

    solved_poses : {frame: (4, 4)} solved; candidates : {frame: ((4, 4), ...)} candidates; t : (F,) s
    One candidate must lie within what neighbours predict solved frames to, and every other beyond it and WORSE times as
    far.
    A frame so decided is a neighbour in its turn.
    Returns {frame: T_world_body (4, 4)}
    """
    reach, known = neighbour_rotation_scatter(solved_poses, t), dict(solved_poses)
    chosen: Poses = {}
    if reach is None:
        return chosen
    waiting = set(candidates)
    while waiting:
        fresh = {}
        for f in waiting:
            expected, limit = neighbour_pose_and_turn_bound(known, f, t, reach)
            if expected is None or not limit < MOST:
                continue
            miss = np.array([rotation_angle_between_poses(expected, one) for one in candidates[f]])
            order = np.argsort(miss)
            if miss[order[0]] <= limit and (miss[order[1:]] > max(limit, WORSE * miss[order[0]])).all():
                fresh[f] = candidates[f][order[0]]
        chosen |= fresh
        known |= fresh
        waiting = {f for f in candidates if f not in chosen and any(abs(f - k) < AROUND for k in fresh)}
    return chosen


def rotation_outlier_reasons_by_frame(solved_poses: Poses, t: Floats) -> dict[int, str]:
    """Reasons why rotations are outliers, by frame.

    They are of solved poses (4, 4).
    Flips against well-predicted neighbours.
    t : (F,) s
    Returns {frame: reason}
    """
    reach = neighbour_rotation_scatter(solved_poses, t)
    odd: dict[int, str] = {}
    if reach is None:
        return odd
    for f, T in solved_poses.items():
        if None not in _near(solved_poses, f, t):
            expected, limit = neighbour_pose_and_turn_bound(solved_poses, f, t, reach)
            if expected is not None and rotation_angle_between_poses(expected, T) > max(2 * limit, MOST):
                odd[f] = (
                    f"it turns by {np.degrees(rotation_angle_between_poses(expected, T)):.0f} degrees relative to the "
                    "frames before and after"
                )
    return odd


def neighbour_rotation_scatter(solved_poses: Poses, t: Floats) -> Reach | None:
    """Scatter (Reach) of rotation about what neighbouring solved frames predict.

    None with too few.
    t : (F,) s
    """
    between, adjacent = [], []
    for f, T in solved_poses.items():
        before, after = _near(solved_poses, f, t)
        if before is not None and after is not None:
            between.append(
                rotation_angle_between_poses(_between(solved_poses, before, after, f, t), T)
                / (t[after] - t[before]) ** 2
            )
            adjacent.append(rotation_angle_between_poses(solved_poses[before], T) / (t[f] - t[before]))
    if len(between) < ENOUGH:
        return None
    return Reach(MARGIN * np.quantile(between, 0.9), MARGIN * np.quantile(adjacent, 0.9))


def neighbour_pose_and_turn_bound(
    solved_poses: Poses, f: int, t: Floats, scatter: Reach
) -> tuple[Floats | None, float]:
    """Pose (4, 4) of frame f from solved neighbours, and the rad that it may be off.

    (None, inf) without any
    """
    before, after = _near(solved_poses, f, t)
    ways = [(scatter.adjacent * abs(t[f] - t[k]), k) for k in (before, after) if k is not None]
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
                for k in range(f + step, min(max(f + step * AROUND, -1), last + 1), step)
                if k in found and abs(t[f] - t[k]) <= FAR
            ),
            None,
        )
        for step in (-1, 1)
    ]


def _between(found: Poses, before: int, after: int, f: int, t: Floats) -> Floats:
    """(4, 4) at frame f on an even way from one solved frame to another."""
    share, T_a, T_b = (t[f] - t[before]) / (t[after] - t[before]), found[before], found[after]
    turn = Rotation.from_matrix(T_a[:3, :3].T @ T_b[:3, :3]).as_rotvec()
    out = (1 - share) * T_a + share * T_b
    out[:3, :3] = T_a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    return out


def rotation_angle_between_poses(T_a: Floats, T_b: Floats) -> float:
    """Angle, rad, between the rotations of two poses (4, 4)."""
    return float(np.arccos(np.clip((np.einsum("ij,ij", T_a[:3, :3], T_b[:3, :3]) - 1) / 2, -1, 1)))


GATE = 5.0  # standard deviations; beyond, a corner is an outlier
ITERATIONS = 25
SOFT = 10  # iterations, after which outliers are cut off at the latest
CALM = 1e-5  # m or rad; a step so short ends the soft weights
MEDIAN = 1.386  # of chi-square with 2 degrees of freedom
AHEAD = 1e-6  # m; what is nearer to the camera's plane is behind it


@njit(cache=True, nogil=True, error_model="numpy")
def refine_pose_in_place(
    corners: tuple[Floats, Floats, Floats, Integers],
    to_camera: Floats,
    focal: Floats,
    matrix: Floats,
    inliers: Booleans,
    least_scale: float,
    J: Floats,
    square: Floats,
) -> float:
    """Refine a pose in place; return the robust scale.

    corners : (points (n, 3) m in the body, ideal (n, 2), their covariance (n, 2, 2), camera (n,)); to_camera : (c, 4,
        4) T_camera_world
    focal : (c,) px; least_scale : px, the scale's floor; J : (n, 2, 6) filled with the whitened derivatives, square :
        (n,) with the squares
    Returns the whitened robust scale at the optimum, or NaN without one
    Raises LinAlgError for a step that nothing determines. Geman-McClure weights at first, then a plain fit of the
        inliers.
    """
    points, ideal, covariance, camera = corners
    n = len(points)
    root, r, seen = np.zeros((n, 3)), np.zeros((n, 2)), np.isfinite(ideal[:, 0])
    finest = _roots(covariance, focal, camera, seen, root, least_scale)
    inliers &= seen
    hard, calm, scale = False, False, np.nan
    for iteration in range(ITERATIONS):
        if inliers.sum() < 4 or not _linearise(corners, to_camera, matrix, root, r, J):
            return np.nan
        for i in range(n):
            square[i] = r[i, 0] ** 2 + r[i, 1] ** 2 if seen[i] else np.inf
        scale = max(np.sqrt(np.median(square[inliers]) / MEDIAN), finest)
        gate = square < (GATE * scale) ** 2
        if hard and calm and (gate == inliers).all():
            break
        hard = hard or calm or iteration > SOFT
        H, g = np.zeros((6, 6)), np.zeros(6)
        for i in range(n):
            inliers[i] = gate[i] or (inliers[i] and not hard)
            w = (1.0 if inliers[i] else 0.0) if hard else 1 / (1 + square[i] / (3 * scale) ** 2) ** 2
            if w > 0.0:
                for row in range(2):
                    for a in range(6):
                        g[a] += w * J[i, row, a] * r[i, row]
                        for b in range(6):
                            H[a, b] += w * J[i, row, a] * J[i, row, b]
        step = np.linalg.solve(H, g)
        for i in range(3):
            for k in range(3):
                matrix[i, 3] += matrix[i, k] * step[k]
        rotate_in_place(matrix[:3, :3], step[3:])
        calm = np.abs(step).max() < CALM
    return scale


@njit(cache=True, nogil=True, error_model="numpy")
def _roots(covariance: Floats, focal: Floats, camera: Integers, seen: Booleans, root: Floats, least: float) -> float:
    """Into root (n, 3) the lower triangle (11, 21, 22) of each covariance's inverse square root. Returns least px in
    units of the typical corner.
    """
    typical = np.zeros(len(camera))
    for i in range(len(camera)):
        a, b, c = (covariance[i, 0, 0], covariance[i, 1, 0], covariance[i, 1, 1]) if seen[i] else (1.0, 0.0, 1.0)
        l11 = np.sqrt(a)
        l21 = b / l11
        l22 = np.sqrt(c - l21 * l21)
        root[i, 0], root[i, 1], root[i, 2] = 1 / l11, -l21 / (l11 * l22), 1 / l22
        typical[i] = focal[camera[i]] * np.sqrt((a + c) / 2)
    return least / np.median(typical[seen])


@njit(cache=True, nogil=True, error_model="numpy")
def _linearise(
    corners: tuple[Floats, Floats, Floats, Integers],
    to_camera: Floats,
    matrix: Floats,
    root: Floats,
    r: Floats,
    J: Floats,
) -> bool:
    """Whitened residuals into r (n, 2) and derivatives into J (n, 2, 6) at a pose; returns whether all corners are
    ahead of their cameras.
    """
    points, ideal, _, camera = corners
    both = np.zeros((len(to_camera), 3, 4))
    for c in range(len(to_camera)):
        for row in range(3):
            for column in range(4):
                for k in range(4):
                    both[c, row, column] += to_camera[c, row, k] * matrix[k, column]
    for i in range(len(points)):
        M, x, y, z = both[camera[i]], points[i, 0], points[i, 1], points[i, 2]
        u = M[0, 0] * x + M[0, 1] * y + M[0, 2] * z + M[0, 3]
        v = M[1, 0] * x + M[1, 1] * y + M[1, 2] * z + M[1, 3]
        w = M[2, 0] * x + M[2, 1] * y + M[2, 2] * z + M[2, 3]
        if not w > AHEAD:
            return False
        u, v = u / w, v / w
        du, dv = ideal[i, 0] - u, ideal[i, 1] - v
        du, dv = du if np.isfinite(du) else 0.0, dv if np.isfinite(dv) else 0.0
        r[i, 0], r[i, 1] = root[i, 0] * du, root[i, 1] * du + root[i, 2] * dv
        for k in range(3):
            a, b = (M[0, k] - u * M[2, k]) / w, (M[1, k] - v * M[2, k]) / w
            J[i, 0, k], J[i, 1, k] = root[i, 0] * a, root[i, 1] * a + root[i, 2] * b
        for row in range(2):
            a, b, c = J[i, row, 0], J[i, row, 1], J[i, row, 2]
            J[i, row, 3], J[i, row, 4], J[i, row, 5] = c * y - b * z, a * z - c * x, b * x - a * y
    return True
