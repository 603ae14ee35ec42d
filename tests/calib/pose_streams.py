"""Streams of poses one at a time, with something that jumps on the way, for tests and benchmarks of on-line
learning.
"""

from dataclasses import dataclass

import numpy as np

from calib.online.hexapod_information_filter import Online
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters, mechanism_with_parameters
from rig.model.pose import exp
from rig.planning.configuration_generators import sobol_configurations
from synthetic import random_true_machine_and_truth_file
from tests.calib.noisy_samples import OWN

COVARIANCE = np.diag(OWN**2)


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """commands : (n, 6) m; T : RigidTransform (n,) measured; before, after : true Hexapods before and after the jump;
    at : its first pose
    """

    commands: np.ndarray
    T: object
    before: object
    after: object
    at: int


def stream(design, seed, count, at=None, jump=None, moved=None):
    """Stream of `count` poses; from pose `at` on the parameters are off by jump (42,) m, or the measured frame by moved
    (6,).
    """
    rng = np.random.default_rng(seed)
    before = random_true_machine_and_truth_file.random_true_machine(design, rng).true.mechanism
    after = before if jump is None else mechanism_with_parameters(before, geometric_parameters(before) + jump)
    commands = sobol_configurations(design.mechanism.strut_range, count, 0.9, seed)
    split = count if at is None else at
    matrices = np.concatenate(
        [hexapod.forward(commands[:split], before).as_matrix(), hexapod.forward(commands[split:], after).as_matrix()]
    )
    if moved is not None:
        matrices[split:] = exp(np.asarray(moved, float)).as_matrix() @ matrices[split:]
    from scipy.spatial.transform import RigidTransform

    return Stream(
        commands, RigidTransform.from_matrix(matrices) * exp(OWN * rng.normal(size=(count, 6))), before, after, split
    )


def learnt(design, poses, learner=None):
    """(the learner, its Updates) after a whole Stream."""
    learner = Online(design.mechanism) if learner is None else learner
    return learner, [learner.update(x, T, COVARIANCE) for x, T in zip(poses.commands, poses.T)]


def sigma_of(learner, strut):
    """m, standard error with which the last pose alone told the length of a strut (1..6), everything else as known
    then.
    """
    from calib.online.information_filter_kernels_and_change_detection import KINDS, WINDOW

    total = learner.state.estimate.sums[(learner.state.learnt - 1) % WINDOW]
    return float(total[1 + KINDS + (KINDS + 1) * (strut - 1)] ** -0.5)


def missed_step(design, seed, before=150, after=20):
    """(Stream, learner, Updates, strut, size m) with a missed step of 4 to 10 such standard errors."""
    rng = np.random.default_rng(seed + 100_000)
    learner, _ = learnt(design, stream(design, seed, before))
    strut = int(rng.integers(1, 7))
    size = float(rng.choice([-1, 1]) * rng.uniform(4, 10) * sigma_of(learner, strut))
    poses = stream(design, seed, before + after, before, size * np.eye(42)[35 + strut])
    return poses, *learnt(design, poses), strut, size


def found_within(updates, at, strut, poses=3):
    """Whether the jump of a strut from pose `at` on was flagged within so many poses, as that strut's and no
    other's.
    """
    flagged = [(u.number, c) for u in updates for c in u.changes]
    return bool(flagged) and all(c.strut == strut for _, c in flagged) and at <= flagged[0][0] < at + poses
