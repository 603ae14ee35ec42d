"""Distinct configurations among samples: their numbers, folds and mean samples; repeats count as one."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.samples.pose_samples import Samples, inverse_covariance, time_block_folds
from rig.arrays import Floats, Integers
from rig.model import mechanisms
from rig.model.mechanism_geometry import Arm, Chain
from rig.model.mechanism_kinds import Struts
from rig.model.pose import exp, pose_difference

SAME = 1e-3  # of an axis' range, within which commands are one configuration
# distinct configurations from which a factor is claimed, or has an interval; fewer cannot say whether the model holds
# elsewhere
LEAST = 8


def configuration_numbers(commanded: Floats, ranges: Floats) -> Integers:
    """Configuration number of each command (n,), counted in the order of first visits.

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


def axis_ranges(mechanism: Struts | Arm | Chain) -> Floats:
    """Range of each axis of a mechanism: (axes, 2) m or rad."""
    return mechanisms.kinematics_of(mechanism).travel(mechanism)


def configuration_folds(label: Integers, count: int) -> Integers:
    """Folds of configurations (n,): whole stretches in time, no configuration in two folds."""
    return time_block_folds(label.max() + 1, count)[label]


def mean_sample_per_configuration(samples: Samples, label: Integers, to_pose: Floats) -> Samples:
    """Mean sample of each configuration: its repeats averaged, weighted by their covariance.

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
    weight = inverse_covariance(np.where(unseen, 1.0, samples.covariance))
    total, mean, common = (np.zeros((count, *part.shape[1:])) for part in (weight, apart, samples.common))
    np.add.at(total, label, weight)
    np.add.at(mean, label, (weight @ apart[..., None])[..., 0])
    np.add.at(common, label, weight @ samples.common)
    covariance = inverse_covariance(total)
    poses = moved[first] * exp((covariance @ mean[..., None])[..., 0])
    return Samples(
        samples.frame[first],
        samples.t[first],
        commanded,
        poses,
        np.where(unseen[first], np.inf, covariance),
        covariance @ common,
        effective - commanded,
    )
