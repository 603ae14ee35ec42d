"""The other learners: one law for all, and what each is for."""

import numpy as np
import pytest

from calib.identify.geometry import identify, parameters, pose_jacobian
from calib.online.learners import Drifting, FirstOrder, Forgetting
from rig.errors import RigError
from rig.mechanisms import hexapod
from rig.pose import difference, exp
from tests.calib.streams import COVARIANCE, learnt, stream
from tests.calib.worlds import OWN, rms, sampled, workspace

ALL = (Forgetting, Drifting, FirstOrder)


def model_error(design, found, true):
    lengths = hexapod.inverse(workspace(design, 100), design.mechanism)
    return rms(difference(hexapod.forward(lengths, true), hexapod.forward(lengths, found)))[0]


@pytest.mark.parametrize("way", ALL)
def test_every_learner_gets_better(design, way):
    poses = stream(design, 1, 400)
    learner, _ = learnt(design, poses, way(design.mechanism))
    before, after = (model_error(design, m, poses.after) for m in (design.mechanism, learner.hexapod))
    assert after < before / (5 if way is FirstOrder else 50)


@pytest.mark.parametrize("way", ALL)
def test_every_learner_refuses_alike_and_stays(design, way):
    learner = way(design.mechanism)
    with pytest.raises(RigError, match="close on no pose"):
        learner.update([0.1, 5.0, 0.1, 5.0, 0.1, 5.0], design.mechanism.home, COVARIANCE)
    np.testing.assert_array_equal(learner.p, parameters(design.mechanism))


@pytest.mark.parametrize("way, options", [(Forgetting, {"kept": 1.0}), (Drifting, {"drift": 0.0})])
def test_without_forgetting_or_drift_it_is_the_batch(design, way, options):
    samples, _ = sampled(design, 3, count=300, own=OWN)
    batch = identify(samples, design.mechanism)
    learner = way(design.mechanism, **options)
    for x, T, C in zip(samples.commanded, samples.T_base_platform, samples.covariance):
        learner.update(x, T, C)
    error = learner.p - parameters(batch.hexapod)
    assert error @ np.linalg.solve(batch.covariance, error) < 1  # of 42; nothing is linearised twice here
    np.testing.assert_allclose(np.diag(learner.covariance), np.diag(batch.covariance), rtol=1e-2)


def test_forgetting_does_not_wind_up(design):
    """The same two poses for ever: what they do not tell is neither forgotten nor invented."""
    learner, _ = learnt(design, stream(design, 1, 100), Forgetting(design.mechanism, 0.9))
    known = np.sqrt(np.diag(learner.covariance)).copy()
    rng, poses = np.random.default_rng(0), stream(design, 1, 2)
    for k in range(500):
        T = hexapod.forward(poses.commands[k % 2], poses.after) * exp(OWN * rng.normal(size=6))
        learner.update(poses.commands[k % 2], T, COVARIANCE)
    told = np.concatenate(pose_jacobian(hexapod.forward(poses.commands, poses.after), learner.hexapod))
    unseen = np.linalg.svd(told)[2][12:]
    assert np.sqrt(np.einsum("ki,ij,kj->k", unseen, learner.covariance, unseen)).max() < 2 * known.max()


def test_a_drift_is_followed(design):
    rng, poses = np.random.default_rng(0), stream(design, 2, 600)
    true = poses.after
    drifting, fixed = Drifting(design.mechanism, 1e-6), Drifting(design.mechanism, 0.0)
    from dataclasses import replace

    for k, x in enumerate(poses.commands):
        now = replace(true, strut_zeros=true.strut_zeros + 1e-6 * max(k - 200, 0) * np.array([1, 0, 0, 0, 0, 0]))
        T = hexapod.forward(x, now) * exp(OWN * rng.normal(size=6))
        for learner in (drifting, fixed):
            learner.update(x, T, COVARIANCE)
    assert model_error(design, drifting.hexapod, now) < 0.25 * model_error(design, fixed.hexapod, now)


def test_a_share_above_one_is_refused(design):
    with pytest.raises(ValueError, match="share"):
        Forgetting(design.mechanism, 1.1)
