"""The other learners: one law for all, and what each is for."""

import numpy as np
import pytest

from calib.models.platform.platform_identification import identify_platform, pose_parameter_jacobian
from calib.online import forgetting_least_squares_kalman_and_gradient_learners as learners
from calib.online.forgetting_least_squares_kalman_and_gradient_learners import Drifting, FirstOrder, Forgetting
from rig.errors import FileError, RigError
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model.mechanisms import hexapod, kinematics_of
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.model.pose import exp, pose_difference
from tests.calib.noisy_samples import OWN, rms, sampled, workspace
from tests.calib.pose_streams import COVARIANCE, learnt, stream
from tests.conftest import ROOT

ALL = (Forgetting, Drifting, FirstOrder)


def model_error(design, found, true):
    lengths = hexapod.inverse(workspace(design, 100), design.mechanism)
    return rms(pose_difference(hexapod.forward(lengths, true), hexapod.forward(lengths, found)))[0]


@pytest.mark.parametrize("method", ALL)
def test_every_learner_gets_better(design, method):
    poses = stream(design, 1, 400)
    learner, _ = learnt(design, poses, method(design.mechanism))
    before, after = (model_error(design, m, poses.after) for m in (design.mechanism, learner.mechanism))
    assert after < before / (5 if method is FirstOrder else 50)


@pytest.mark.parametrize("method", ALL)
def test_every_learner_refuses_alike_and_stays(design, method):
    learner = method(design.mechanism)
    with pytest.raises(RigError, match="closes on no pose"):
        learner.update([0.1, 5.0, 0.1, 5.0, 0.1, 5.0], design.mechanism.home, COVARIANCE)
    np.testing.assert_array_equal(learner.p, geometric_parameters(design.mechanism))


@pytest.mark.parametrize("method, options", [(Forgetting, {"kept": 1.0}), (Drifting, {"drift": 0.0})])
def test_without_forgetting_or_drift_it_is_the_batch(design, method, options):
    samples, _ = sampled(design, 3, count=300, own=OWN)
    batch = identify_platform(samples, design.mechanism)
    learner = method(design.mechanism, **options)
    for x, T, C in zip(samples.commanded, samples.T_base_platform, samples.covariance):
        learner.update(x, T, C)
    error = learner.p - geometric_parameters(batch.mechanism)
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
    jacobian = np.concatenate(pose_parameter_jacobian(hexapod.forward(poses.commands, poses.after), learner.mechanism))
    unseen = np.linalg.svd(jacobian)[2][12:]
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
    assert model_error(design, drifting.mechanism, now) < 0.25 * model_error(design, fixed.mechanism, now)


def test_a_share_above_one_is_refused(design):
    with pytest.raises(ValueError, match="share"):
        Forgetting(design.mechanism, 1.1)


@pytest.mark.parametrize("method, setting", [(Forgetting, 0.95), (Drifting, 3e-7), (FirstOrder, 2e-3)])
def test_a_learner_goes_on_from_its_file_as_if_it_had_never_stopped(design, tmp_path, method, setting):
    poses = stream(design, 1, 40)
    through, path = method(design.mechanism, setting), tmp_path / "state.json"
    stopped = method(design.mechanism, setting)
    for k, (x, T) in enumerate(zip(poses.commands, poses.T)):
        if k == 20:
            stopped.data = {"a", "b"}
            learners.save_learner(path, stopped)
            stopped = learners.load_learner(path)
        through.update(x, T, COVARIANCE)
        stopped.update(x, T, COVARIANCE)
    np.testing.assert_array_equal(stopped.p, through.p)
    assert (stopped.number, stopped.setting, stopped.data, type(stopped)) == (40, setting, {"a", "b"}, method)


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda text: text[: len(text) // 2], "cut off"),
        (lambda text: text.replace("forgetting", "guessing"), "must be one of 'forgetting'"),
        (lambda text: text.replace('"kept": 0.99', '"kept": 1.5'), "kept must be a share"),
        (lambda text: text.replace('"number": 0', '"number": -1'), "number must"),
        (lambda text: text.replace("learner/1", "learner/9"), "was written by a newer rig: its schema is 'learner/9'"),
    ],
)
def test_a_spoilt_file_of_a_learner_is_refused(design, tmp_path, spoil, says):
    path = tmp_path / "state.json"
    learners.save_learner(path, Forgetting(design.mechanism))
    path.write_text(spoil(path.read_text()))
    with pytest.raises(FileError, match=says) as error:
        learners.load_learner(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("method", ALL)
def test_what_a_calibration_knows_is_not_thrown_away(design, method):
    poses = stream(design, 1, 20)
    learner = method(poses.before)
    learner.start_from(np.eye(42) * 1e-12)
    learnt(design, poses, learner)
    assert np.abs(learner.p - geometric_parameters(poses.before)).max() < 2e-5


@pytest.fixture
def crank_pose():
    """(mechanism whose parameters count otherwise than in m and rad, axis values, a pose off its model)."""
    mechanism = load_design(ROOT / "docs" / "kinematics" / "cranks.toml").mechanism
    values = kinematics_of(mechanism).home_values(mechanism)
    T = kinematics_of(mechanism).forward(values, mechanism) * exp(np.full(6, 1e-4))
    return mechanism, values, T


def test_drift_is_in_m_and_rad_whatever_the_parameters_count(crank_pose):
    mechanism, values, T = crank_pose
    learner = Drifting(mechanism, drift=1e-3)
    learner.memory = np.zeros_like(learner.memory)
    learner.update(values, T, 1e6 * np.eye(6))
    scale = learner.parameters.scale[learner.free]
    assert np.ptp(scale) > 1
    np.testing.assert_allclose(np.sqrt(np.diag(learner.covariance)) * scale, 1e-3, rtol=1e-3)


def test_a_first_step_is_in_m_and_rad_whatever_the_parameters_count(crank_pose):
    mechanism, values, T = crank_pose
    learner = FirstOrder(mechanism, step=1e-5)
    before = learner.p
    learner.update(values, T, COVARIANCE)
    moved = (np.abs(learner.p - before) * learner.parameters.scale)[learner.free][learner.memory > 1e-12]
    assert len(moved) > 12
    np.testing.assert_allclose(moved, 1e-5)
