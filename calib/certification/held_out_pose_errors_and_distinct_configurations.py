"""Held-out pose errors of recordings, and distinct configurations.

Errors with repeatability; of distinct configurations numbers, folds and mean samples.

Only exposures of a machine at rest count, and of each configuration the first visit alone speaks for poses at large:
the others are repeats, from which repeatability is read.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.machine_correction import AnyCorrection
from calib.identify.bounded_and_robust_least_squares_fit import time_block_folds
from calib.samples.commanded_and_measured_pose_samples import Samples, pose_covariance_pseudoinverse
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel
from rig.model.pose import exp, pose_difference
from rig.recording.recording_folder import Commands

SAME = 1e-3  # of an axis' range, within which commands are one configuration
# distinct configurations from which a factor is claimed, or has an interval; fewer cannot say whether the model holds
# elsewhere
LEAST = 8


def configuration_numbers(commanded: Floats, ranges: Floats) -> Integers:
    """Configuration number of each command (n,).

    They are counted in the order of first visits.
    commanded : (n, axes) m or rad; ranges : (axes, 2) of the axes
    """
    scaled = np.asarray(commanded, float) / (SAME * np.ptp(ranges, axis=1))
    out, first = np.empty(len(scaled), int), np.empty_like(scaled)
    count = 0
    for k, row in enumerate(scaled):
        near = np.flatnonzero((np.abs(first[:count] - row) <= 1).all(axis=1))
        if not len(near):
            first[count], near, count = row, np.array([count]), count + 1
        out[k] = near[0]
    return out


def axis_travel_limits(mechanism: Parallel | Arm | Chain) -> Floats:
    """Travel limits of each axis of a mechanism.

    Returns (axes, 2) m or rad
    """
    return mechanisms.kinematics_of(mechanism).travel_ranges(mechanism)


def time_block_folds_of_configurations(label: Integers, count: int) -> Integers:
    """Folds of configurations (n,) by blocks of time.

    They are whole stretches in time, with no configuration in two folds.
    """
    return time_block_folds(label.max() + 1, count)[label]


def mean_sample_per_configuration(samples: Samples, label: Integers, to_pose: Floats) -> Samples:
    """Mean sample per configuration.

    Its repeats averaged, weighted by their covariance.
    samples : Samples; label : (n,) from `configuration_numbers`; to_pose : (n, 6, axes) change of each pose's tangent
        with the commands
    """
    count = label.max() + 1
    if count == len(samples):
        return samples
    first, size = np.unique(label, return_index=True)[1], np.bincount(label)
    commanded, effective = (
        np.stack([np.bincount(label, weights=column) for column in values.T], axis=1) / size[:, None]
        for values in (samples.commanded, samples.effective)
    )
    moved = samples.T_base_platform * exp(np.einsum("nij,nj->ni", to_pose, effective[label] - samples.effective))
    apart = pose_difference(RigidTransform.from_matrix(moved.as_matrix()[first][label]), moved)
    unseen = np.isinf(samples.covariance)  # rotations that nothing measured
    weight = pose_covariance_pseudoinverse(np.where(unseen, 1.0, samples.covariance))
    total, mean, common = (np.zeros((count, *part.shape[1:])) for part in (weight, apart, samples.common))
    np.add.at(total, label, weight)
    np.add.at(mean, label, (weight @ apart[..., None])[..., 0])
    np.add.at(common, label, weight @ samples.common)
    covariance = pose_covariance_pseudoinverse(total)
    poses = moved[first] * exp((covariance @ mean[..., None])[..., 0])
    return Samples(
        samples.frame[first],
        samples.t[first],
        commanded,
        poses,
        np.where(unseen[first], np.inf, covariance),
        covariance @ common,
        effective - commanded,
        hand=None if samples.hand is None else samples.hand[first],
    )


REST = 0.25  # s before an exposure, over which nothing was commanded to move


@dataclass(frozen=True, slots=True, eq=False)
class HeldPoses:
    """n poses at rest, of r recordings.

    recording : (n,) index of each one's; frame, t : (n,), (n,) s; commanded : (n, axes) m or rad
    before : (n, axes) sign of each axis' last move, 0 where it never moved; step : (n, axes) bool, which axes the
        machine's last move moved
    T_base_platform : RigidTransform (n,) measured; errors : (n, 6) of them against the calibrated machine's, NaN where
    a rotation was not measured, m and rad; plain : the same against the nominal model; own : (n, 6, 6) noise of each;
        common : of each
    recording the (n, 6, k) factor of what it shares, 0 for the others' poses
    label : (n,) configuration; moving : how many exposures were left out since the machine moved
    """

    recording: Floats
    frame: Integers
    t: Floats
    commanded: Floats
    before: Floats
    step: Floats
    T_base_platform: RigidTransform
    errors: Floats
    plain: Floats
    own: Floats
    common: tuple[Floats, ...]
    label: Integers
    moving: int

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def first(self) -> Integers:
        """(c,) indices of each configuration's first visit, those left out that one axis alone came to: a ladder tells
        of an axis, and would crowd the middle of the volume."""
        at = np.flatnonzero(self.step.sum(axis=1) != 1)
        return at[np.unique(self.label[at], return_index=True)[1]]

    @property
    def rotations(self) -> bool:
        """Whether rotations were measured."""
        return bool(np.isfinite(self.errors[:, 3:]).all())

    def sigma(self, part: slice) -> Floats:
        """(n,) m or rad, standard deviation of each pose's own noise in one direction, of positions or rotations; of
        directions slice(3, 5).
        """
        return np.sqrt(np.trace(self.own[:, part, part], axis1=1, axis2=2) / (part.stop - part.start))


def _is_at_rest(commands: Commands, t: Floats) -> Booleans:
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


def _last_moves(commands: Commands, t: Floats) -> tuple[Floats, Floats]:
    """(before (n, axes) sign of each axis' last move before times t (n,) s, step (n, axes) whether it was part of the
    machine's last).
    """
    moves = np.sign(np.where(np.abs(np.diff(commands.values, axis=0)) > 1e-9, np.diff(commands.values, axis=0), 0.0))
    rows = np.where(moves != 0, np.arange(1, len(moves) + 1)[:, None], 0)
    last = np.vstack([np.zeros((1, moves.shape[1]), int), np.maximum.accumulate(rows, axis=0)])  # 0: never moved
    at = last[np.searchsorted(commands.t, t, side="left").clip(0, len(moves))]
    sign = np.where(at > 0, np.take_along_axis(moves, np.maximum(at - 1, 0), axis=0), 0.0)
    return sign, (at == at.max(axis=1, keepdims=True)) & (at > 0)


def held_out_poses(
    correction: AnyCorrection, recordings: Sequence[tuple[Samples, Commands, Floats, Floats]]
) -> HeldPoses:
    """Held-out poses of recordings under a correction, as HeldPoses.

    recordings : (Samples, Commands, plain poses (n, 6), errors (n, 6) m and rad) of each

    Raises NotEnoughData where the machine never stood still, RigError where neither positions nor directions were
    measured, or positions of some recordings and directions of others
    """
    measured = {samples.measured for samples, *_ in recordings}
    for one in ("orientation", "distance"):
        if one in measured:
            raise RigError(f"a certificate speaks for poses, and of these the {one} alone was measured")
    if "direction" in measured and len(measured) > 1:
        raise RigError("directions were measured in some recordings and poses in others: certify with either alone")
    retained = [np.flatnonzero(_is_at_rest(commands, samples.t)) for samples, commands, _, _ in recordings]
    moving = sum(len(samples) - len(k) for k, (samples, *_) in zip(retained, recordings))
    if not sum(map(len, retained)):
        raise NotEnoughData(
            f"none of {moving} exposures is of a machine at rest for {REST:g} s; a certificate describes "
            "poses that are held: record some at rest (rig run without --in-motion); rig verify takes those in motion"
        )
    each = [
        (samples.take(k), commands, plain[k], errors[k])
        for k, (samples, commands, plain, errors) in zip(retained, recordings)
    ]
    sizes = [len(samples) for samples, *_ in each]
    ends = np.cumsum(sizes)
    common = []
    for size, end, (samples, *_) in zip(sizes, ends, each):
        factor = np.zeros((int(ends[-1]), *samples.common.shape[1:]))
        factor[end - size : end] = samples.common
        common.append(factor)
    commanded = np.concatenate([samples.commanded for samples, *_ in each])
    moves = [_last_moves(commands, samples.t) for samples, commands, *_ in each]
    T = RigidTransform.from_matrix(np.concatenate([samples.T_base_platform.as_matrix() for samples, *_ in each]))
    own = np.concatenate([np.where(np.isinf(samples.covariance), 0.0, samples.covariance) for samples, *_ in each])
    return HeldPoses(
        np.repeat(np.arange(len(recordings)), sizes),
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
        configuration_numbers(commanded, axis_travel_limits(correction.nominal)),
        moving,
    )


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
    """Repeatability of revisited poses."""
    noise = tuple(float(np.sqrt(3) * np.sqrt((poses.sigma(part) ** 2).mean())) for part in (slice(0, 3), slice(3, 6)))
    position, rotation, visits, count = _scatter(poses, poses.label)
    sides = np.unique(np.column_stack([poses.label, poses.recording, poses.before]), axis=0, return_inverse=True)[
        1
    ].ravel()
    one = _scatter(poses, sides)
    return Repeatability(
        position, rotation, None if one[0] is None else (one[0], one[1] or 0.0), (noise[0], noise[1]), visits, count
    )


def _scatter(poses: HeldPoses, group: Integers) -> tuple[float | None, float | None, int, int]:
    """(position m, rotation rad, visits, groups) of groups with two visits at least."""
    size = np.bincount(group)
    repeated = np.flatnonzero(size[group] > 1)
    if not len(repeated):
        return None, None, 0, 0
    index = np.unique(group[repeated], return_inverse=True)[1]
    count = int(index.max()) + 1
    mean = (
        np.stack([np.bincount(index, weights=column) for column in poses.errors[repeated].T], axis=1)
        / np.bincount(index)[:, None]
    )
    off = poses.errors[repeated] - mean[index]
    lengths = [
        float(np.sqrt((off[:, part] ** 2).sum() / (len(repeated) - count))) for part in (slice(0, 3), slice(3, 6))
    ]
    return lengths[0], lengths[1] if poses.rotations else None, len(repeated), count
