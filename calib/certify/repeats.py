"""Poses that were visited again: repeatability, the floor of all errors, and ISO 9283's pose accuracy and pose repeatability.

Of each pose that was visited k times from commands alike: AP, the barycentre's distance from where the pose should be; l_j, the visits' distances
from the barycentre; RP = mean of l + 3 s_l; for rotations AP and RP = 3 s axis by axis. ISO 9283 asks for five poses and thirty visits
each; what a recording has short of that is reported with its counts. docs/mathematics.md (27)
"""

from dataclasses import dataclass

import numpy as np

from calib.certify.held_poses import HeldPoses

VISITS, POSES = 30, 5  # of ISO 9283
FEWEST = 3  # visits from which a scatter is told
ABOUT = ("about x", "about y", "about z")


@dataclass(frozen=True, slots=True)
class RepeatedPose:
    """place : (3,) m; visits; AP, RP : m; AP_axes, RP_axes : (3,) rad about x y z of the platform, None where no rotation was measured
    approaches : from how many sides it was come to."""

    place: tuple[float, ...]
    visits: int
    approaches: int
    AP: float
    RP: float
    AP_axes: tuple[float, ...] | None
    RP_axes: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Repeatability:
    """position m, rotation rad : RMS distance of visits from their pose's barycentre, freedom allowed for, measuring noise included
    one_sided : the same of visits come to from one side; each None where nothing was visited again so; noise : (m, rad) of one measured pose
    visits, poses : how many."""

    position: float | None
    rotation: float | None
    one_sided: tuple[float, float] | None
    noise: tuple[float, float]
    visits: int
    poses: int


@dataclass(frozen=True, slots=True)
class Iso9283:
    """repeated : RepeatedPose of poses with FEWEST visits at least; formal : whether they are as many, visited as often, as the standard asks
    random : AP over all distinct poses, one visit each: n, mean, greatest (m), and the same of rotations (rad) or None."""

    repeated: tuple[RepeatedPose, ...]
    formal: bool
    random: tuple[int, float, float]
    random_rotation: tuple[float, float] | None


def repeatability(poses: HeldPoses) -> Repeatability:
    """Repeatability of HeldPoses."""
    noise = tuple(float(np.sqrt(3) * np.sqrt((poses.sigma(part) ** 2).mean())) for part in (slice(0, 3), slice(3, 6)))
    position, rotation, visits, count = _scatter(poses, poses.label)
    sides = np.unique(np.column_stack([poses.label, poses.recording, poses.before]), axis=0, return_inverse=True)[1].ravel()
    one = _scatter(poses, sides)
    return Repeatability(position, rotation, None if one[0] is None else (one[0], one[1] or 0.0), (noise[0], noise[1]), visits, count)


def _scatter(poses: HeldPoses, group: np.ndarray) -> tuple[float | None, float | None, int, int]:
    """(position m, rotation rad, visits, groups) of groups with two visits at least."""
    size = np.bincount(group)
    again = np.flatnonzero(size[group] > 1)
    if not len(again):
        return None, None, 0, 0
    index = np.unique(group[again], return_inverse=True)[1]
    count = int(index.max()) + 1
    mean = np.stack([np.bincount(index, weights=column) for column in poses.errors[again].T], axis=1) / np.bincount(index)[:, None]
    off = poses.errors[again] - mean[index]
    lengths = [float(np.sqrt((off[:, part] ** 2).sum() / (len(again) - count))) for part in (slice(0, 3), slice(3, 6))]
    return lengths[0], lengths[1] if poses.rotations else None, len(again), count


def iso9283(poses: HeldPoses) -> Iso9283:
    """Iso9283 of HeldPoses."""
    rows = []
    for label in np.flatnonzero(np.bincount(poses.label) >= FEWEST):
        at = np.flatnonzero(poses.label == label)
        errors = poses.errors[at]
        mean = errors.mean(axis=0)
        far = np.linalg.norm(errors[:, :3] - mean[:3], axis=1)
        place = tuple(poses.T_base_platform[at].translation.mean(axis=0).tolist())
        turn = (tuple(mean[3:].tolist()), tuple((3 * errors[:, 3:].std(axis=0, ddof=1)).tolist())) if poses.rotations else (None, None)
        rows.append(RepeatedPose(place, len(at), len(np.unique(poses.before[at], axis=0)), float(np.linalg.norm(mean[:3])),
                                 float(far.mean() + 3 * far.std(ddof=1)), *turn))
    first = poses.errors[poses.first]
    lengths, turned = np.linalg.norm(first[:, :3], axis=1), np.linalg.norm(first[:, 3:], axis=1)
    return Iso9283(tuple(rows), sum(row.visits >= VISITS for row in rows) >= POSES, (len(first), float(lengths.mean()), float(lengths.max())),
                   (float(turned.mean()), float(turned.max())) if poses.rotations else None)
