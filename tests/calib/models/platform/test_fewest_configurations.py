"""The fewest poses for a promise: kept on rigs drawn at random, fewer than evenly spread ones, and the next best beside
those given.
"""

import numpy as np
import pytest

from calib.models.platform.identification import identify_platform
from calib.models.platform.optimal_calibration_poses import fewest_configurations
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from tests.calib.noisy_samples import rms, sampled, workspace

SIGMAS = (1e-5, 1e-4)  # m, rad
PROMISE = 2e-5  # m


@pytest.fixture(scope="module")
def found(design):
    return fewest_configurations(design.mechanism, PROMISE, SIGMAS)


def test_what_is_promised_is_kept_and_not_one_pose_sooner(design, found):
    assert (
        found.left[-1] <= PROMISE < found.left[-2]
        and (np.diff(found.left) < 0).all()
        and len(found.left) == len(found.commands) + 1
    )
    wanted = workspace(design, 100)
    holds = []
    for seed in range(12):
        samples, true = sampled(design, seed, len(found.commands), commands=found.commands, own=np.repeat(SIGMAS, 3))
        fitted = identify_platform(samples, design.mechanism, prior=np.full(42, 5e-4)).mechanism
        left = rms(pose_difference(hexapod.forward(hexapod.inverse(wanted, fitted), true), wanted))[0]
        holds.append(left)
    assert np.mean(np.array(holds) <= PROMISE) >= 11 / 12 and np.median(holds) > 0.3 * PROMISE


def test_what_was_visited_counts(design, found):
    rest = fewest_configurations(design.mechanism, PROMISE, SIGMAS, found.commands[:10])
    assert abs(len(rest.commands) + 10 - len(found.commands)) <= 1 and rest.left[0] == pytest.approx(
        found.left[10], rel=1e-6
    )
    assert len(fewest_configurations(design.mechanism, PROMISE, SIGMAS, found.commands).commands) == 0


def test_a_promise_that_measuring_cannot_keep_is_refused(design, monkeypatch):
    monkeypatch.setattr("calib.models.platform.optimal_calibration_poses.MOST", 12)
    with pytest.raises(RigError, match="12 poses leave"):
        fewest_configurations(design.mechanism, 1e-7, SIGMAS)
