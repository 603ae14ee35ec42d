"""Poses of recordings that a calibration was not made from: their errors, what measuring them adds, and which of them
count.

Only exposures of a machine at rest count, and of each configuration the first visit alone speaks for poses at large:
the others are repeats, from which repeatability is read.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify.distinct_configurations import axis_ranges, configuration_numbers
from calib.correct.correction import Correction
from calib.samples.pose_samples import Samples
from rig.errors import NotEnoughData, RigError
from rig.recording.recording_folder import Commands

REST = 0.25  # s before an exposure, over which nothing was commanded to move


@dataclass(frozen=True, slots=True, eq=False)
class HeldPoses:
    """n poses at rest, of r recordings.

    recording : (n,) index of each one's; frame, t : (n,), (n,) s; commanded : (n, axes) m or rad
    before : (n, axes) sign of each axis' last move, 0 where it never moved; step : (n, axes) bool, which axes the
        machine's last move moved
    T_base_platform : RigidTransform (n,) measured; errors : (n, 6) of them against the calibrated machine's, NaN where
    a rotation was not measured, m and rad; plain : the same against the owner's model; own : (n, 6, 6) noise of each;
        common : of each
    recording the (n, 6, k) factor of what it shares, 0 for the others' poses
    label : (n,) configuration; moving : how many exposures were left out since the machine moved
    """

    recording: np.ndarray
    frame: np.ndarray
    t: np.ndarray
    commanded: np.ndarray
    before: np.ndarray
    step: np.ndarray
    T_base_platform: RigidTransform
    errors: np.ndarray
    plain: np.ndarray
    own: np.ndarray
    common: tuple[np.ndarray, ...]
    label: np.ndarray
    moving: int

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def first(self) -> np.ndarray:
        """(c,) indices of each configuration's first visit, those left out that one axis alone came to: a ladder tells
        of an axis, and would crowd the middle of the volume."""
        at = np.flatnonzero(self.step.sum(axis=1) != 1)
        return at[np.unique(self.label[at], return_index=True)[1]]

    @property
    def rotations(self) -> bool:
        """Whether rotations were measured."""
        return bool(np.isfinite(self.errors[:, 3:]).all())

    def sigma(self, part: slice) -> np.ndarray:
        """(n,) m or rad, standard deviation of each pose's own noise in one direction, of positions or rotations."""
        return np.sqrt(np.trace(self.own[:, part, part], axis1=1, axis2=2) / 3)


def is_at_rest(commands: Commands, t: np.ndarray) -> np.ndarray:
    """(n,) bool, whether nothing was commanded to move for REST s before times t (n,) s."""
    earlier = np.maximum(t - REST, commands.t[0])
    between = np.searchsorted(commands.t, t) - np.searchsorted(commands.t, earlier)
    same = np.isclose(commands.at(t), commands.at(earlier), rtol=0, atol=1e-9).all(axis=1)
    knots = np.array(
        [
            np.ptp(commands.values[k - b : k], axis=0).max(initial=0.0) if b else 0.0
            for k, b in zip(np.searchsorted(commands.t, t), between)
        ]
    )
    return same & (knots < 1e-9)


def last_moves(commands: Commands, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(before (n, axes) sign of each axis' last move before times t (n,) s, step (n, axes) whether it was part of the
    machine's last).
    """
    moves = np.sign(np.where(np.abs(np.diff(commands.values, axis=0)) > 1e-9, np.diff(commands.values, axis=0), 0.0))
    rows = np.where(moves != 0, np.arange(1, len(moves) + 1)[:, None], 0)
    last = np.vstack([np.zeros((1, moves.shape[1]), int), np.maximum.accumulate(rows, axis=0)])  # 0: never moved
    at = last[np.searchsorted(commands.t, t, side="left").clip(0, len(moves))]
    sign = np.where(at > 0, np.take_along_axis(moves, np.maximum(at - 1, 0), axis=0), 0.0)
    return sign, (at == at.max(axis=1, keepdims=True)) & (at > 0)


def held_poses(correction: Correction, parts: Sequence[tuple[Samples, Commands, np.ndarray, np.ndarray]]) -> HeldPoses:
    """HeldPoses of recordings, each (Samples, Commands, plain (n, 6), errors (n, 6) as `errors_of` gives them).

    Raises NotEnoughData where the machine never stood still, RigError where positions were not measured
    """
    for samples, *_ in parts:
        if samples.measured in ("orientation", "distance"):
            raise RigError(f"a certificate speaks for poses, and of these the {samples.measured} alone was measured")
    kept = [np.flatnonzero(is_at_rest(commands, samples.t)) for samples, commands, _, _ in parts]
    moving = sum(len(samples) - len(k) for k, (samples, *_) in zip(kept, parts))
    if not sum(map(len, kept)):
        raise NotEnoughData(
            f"none of {moving} exposures is of a machine at rest for {REST:g} s; a certificate speaks for "
            "poses that are held"
        )
    each = [
        (samples.take(k), commands, plain[k], errors[k]) for k, (samples, commands, plain, errors) in zip(kept, parts)
    ]
    sizes = [len(samples) for samples, *_ in each]
    ends = np.cumsum(sizes)
    common = []
    for size, end, (samples, *_) in zip(sizes, ends, each):
        factor = np.zeros((int(ends[-1]), *samples.common.shape[1:]))
        factor[end - size : end] = samples.common
        common.append(factor)
    commanded = np.concatenate([samples.commanded for samples, *_ in each])
    moves = [last_moves(commands, samples.t) for samples, commands, *_ in each]
    T = RigidTransform.from_matrix(np.concatenate([samples.T_base_platform.as_matrix() for samples, *_ in each]))
    own = np.concatenate([np.where(np.isinf(samples.covariance), 0.0, samples.covariance) for samples, *_ in each])
    return HeldPoses(
        np.repeat(np.arange(len(parts)), sizes),
        np.concatenate([samples.frame for samples, *_ in each]),
        np.concatenate([samples.t for samples, *_ in each]),
        commanded,
        np.concatenate([sign for sign, _ in moves]),
        np.concatenate([step for _, step in moves]),
        T,
        np.concatenate([errors for *_, errors in each]),
        np.concatenate([plain for *_, plain, _ in each]),
        own,
        tuple(common),
        configuration_numbers(commanded, axis_ranges(correction.nominal)),
        moving,
    )
