"""Samples of secret machines, with noise of a known covariance, for tests of calibration."""

from dataclasses import replace

import numpy as np

from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.model.mechanisms import hexapod
from rig.model.pose import exp, pose_difference
from rig.planning import configuration_generators
from synthetic import random_true_machine_and_truth_file

OWN = np.array([6e-6, 6e-6, 6e-6, 4e-5, 4e-5, 4e-5])  # m, rad
COMMON = np.array([1e-5, 1e-5, 1e-5, 2e-5, 2e-5, 2e-5])


def sampled(design, seed, count=120, deviation=None, noisy=True, commands=None, own=None, noise_seed=None):
    """(Samples, true Hexapod) of a machine; deviation(commands) -> (n, 6) m is what its struts do beyond their
    geometry.

    commands : (count, 6) m, low-discrepancy ones by default; own : (6,) m, rad of a pose's noise, then nothing is
        shared"""
    rng = np.random.default_rng(seed)
    true = random_true_machine_and_truth_file.random_true_machine(design, rng).true.mechanism
    commands = (
        configuration_generators.sobol_configurations(design.mechanism.strut_range, count, 0.9, seed)
        if commands is None
        else commands
    )
    common, own = (COMMON, OWN) if own is None else (np.zeros(6), own)
    effective = commands if deviation is None else commands + deviation(commands)
    T = hexapod.forward(effective, true)
    rng = rng if noise_seed is None else np.random.default_rng(noise_seed)
    if noisy:
        shared = common * rng.normal(size=6)
        T = T * exp(shared + own * rng.normal(size=(count, 6)))
    samples = Samples(
        np.arange(count),
        np.arange(count) * 10.0,
        commands,
        T,
        np.tile(np.diag(own**2), (count, 1, 1)),
        np.tile(np.diag(common), (count, 1, 1)),
    )
    return samples, true


def real(commands, true, deviation=None):
    """The pose a machine really takes."""
    return hexapod.forward(commands if deviation is None else commands + deviation(commands), true)


def workspace(design, count=300, seed=99):
    """Wanted poses all over the workspace."""
    lengths = configuration_generators.sobol_configurations(design.mechanism.strut_range, count, 0.85, seed)
    return hexapod.forward(lengths, design.mechanism)


def rms(errors):
    """(position m, rotation rad) RMS of the errors' lengths."""
    return np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()), np.sqrt((errors[:, 3:] ** 2).sum(axis=1).mean())


__all__ = ["sampled", "real", "workspace", "rms", "pose_difference", "replace"]
