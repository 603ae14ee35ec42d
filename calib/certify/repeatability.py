"""Poses that were visited again: repeatability, the floor of all errors."""

from dataclasses import dataclass

import numpy as np

from calib.certify.held_out_poses import HeldPoses


@dataclass(frozen=True, slots=True)
class Repeatability:
    """position m, rotation rad : RMS distance of visits from their pose's barycentre, freedom allowed for, measuring
    noise included
    one_sided : the same of visits come to from one side; each None where nothing was visited again so; noise : (m, rad)
        of one measured pose
    visits, poses : how many."""

    position: float | None
    rotation: float | None
    one_sided: tuple[float, float] | None
    noise: tuple[float, float]
    visits: int
    poses: int


def pose_repeatability(poses: HeldPoses) -> Repeatability:
    """Repeatability of HeldPoses."""
    noise = tuple(float(np.sqrt(3) * np.sqrt((poses.sigma(part) ** 2).mean())) for part in (slice(0, 3), slice(3, 6)))
    position, rotation, visits, count = _scatter(poses, poses.label)
    sides = np.unique(np.column_stack([poses.label, poses.recording, poses.before]), axis=0, return_inverse=True)[
        1
    ].ravel()
    one = _scatter(poses, sides)
    return Repeatability(
        position, rotation, None if one[0] is None else (one[0], one[1] or 0.0), (noise[0], noise[1]), visits, count
    )


def _scatter(poses: HeldPoses, group: np.ndarray) -> tuple[float | None, float | None, int, int]:
    """(position m, rotation rad, visits, groups) of groups with two visits at least."""
    size = np.bincount(group)
    again = np.flatnonzero(size[group] > 1)
    if not len(again):
        return None, None, 0, 0
    index = np.unique(group[again], return_inverse=True)[1]
    count = int(index.max()) + 1
    mean = (
        np.stack([np.bincount(index, weights=column) for column in poses.errors[again].T], axis=1)
        / np.bincount(index)[:, None]
    )
    off = poses.errors[again] - mean[index]
    lengths = [float(np.sqrt((off[:, part] ** 2).sum() / (len(again) - count))) for part in (slice(0, 3), slice(3, 6))]
    return lengths[0], lengths[1] if poses.rotations else None, len(again), count
