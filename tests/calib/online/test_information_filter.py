"""One pose at a time: the batch's optimum, what jumps, what is merely wrong, and restarts."""

import gc
import json
import weakref
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    parameter_changes_by_base_and_platform_frame_motion,
)
from calib.models.platform.platform_identification import identify_platform
from calib.online.hexapod_information_filter import Online
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.errors import FileError, RigError
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from tests.calib.noisy_samples import OWN, sampled
from tests.calib.pose_streams import COVARIANCE, found_within, learnt, missed_step, stream


def off(learner, true):
    """Squared error of an estimate (42 on average) by its own covariance, against parameters (42,)."""
    error = learner.p - true
    return error @ np.linalg.solve(learner.covariance, error)


def event_rows(updates):
    return [
        (u.number, u.held, u.dropped, [(c.kind, c.strut, c.onset) for c in u.changes])
        for u in updates
        if u.changes or u.held or u.dropped
    ]


@pytest.mark.parametrize("shared, count", [(0, 250), (6, 250), (0, 16)])  # 16: all are linearised again just then
def test_one_pass_ends_where_the_batch_does(design, shared, count):
    samples, _ = sampled(design, 2, count=count)
    samples = replace(
        samples,
        common=samples.common[:, :, :shared],
        covariance=samples.covariance if shared else samples.total_covariance(),
    )
    batch = identify_platform(samples, design.mechanism)
    learner = Online(design.mechanism, shared=shared)
    for x, T, C, B in zip(samples.commanded, samples.T_base_platform, samples.covariance, samples.common):
        learner.update(x, T, C, B)
    along = np.linalg.svd(batch.root)[2]
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", along, batch.covariance, along))
    assert np.abs(along @ (learner.p - geometric_parameters(batch.mechanism)) / sigma).max() < 0.02
    np.testing.assert_allclose(np.diag(learner.covariance), np.diag(batch.covariance), rtol=2e-3)


def test_a_calibration_is_gone_on_from(design):
    """Learnt from one batch's estimate and covariance with the poses of a second: as one batch of both."""
    samples, _ = sampled(design, 4, count=300, own=OWN)
    samples = replace(samples, common=samples.common[:, :, :0])
    first, both = (identify_platform(part, design.mechanism) for part in (samples.take(np.arange(150)), samples))
    learner = Online(first.mechanism, covariance=first.covariance)
    for i in range(150, 300):
        learner.update(samples.commanded[i], samples.T_base_platform[i], samples.covariance[i])
    error = learner.p - geometric_parameters(both.mechanism)
    assert error @ np.linalg.solve(both.covariance, error) < 0.05
    np.testing.assert_allclose(np.diag(learner.covariance), np.diag(both.covariance), rtol=5e-3)


def test_innovations_are_white(design):
    _, updates = learnt(design, stream(design, 1, 400))
    innovation = np.array([u.innovation for u in updates])
    assert innovation.std() == pytest.approx(1, abs=0.05) and not event_rows(updates)
    assert abs((innovation[1:] * innovation[:-1]).mean()) < 4 / np.sqrt(innovation.size)


@pytest.mark.slow
def test_missed_steps_are_found_and_spoil_nothing(design):
    chi, z = [], []
    for seed in range(12):
        poses, learner, updates, strut, size = missed_step(design, seed)
        assert found_within(updates, poses.at, strut), (seed, event_rows(updates))
        change = next(c for u in updates for c in u.changes)
        z.append((change.size - size) / change.sigma)
        chi.append(off(learner, geometric_parameters(poses.after)))
    assert np.abs(z).max() < 4 and np.mean(chi) == pytest.approx(42, rel=0.25)


def test_a_knocked_joint_is_named_with_its_strut(design):
    jump = np.zeros(42)
    jump[24:27] = [-6e-5, -2e-5, 1.6e-4]
    poses = stream(design, 4, 190, 150, jump)
    learner, updates = learnt(design, poses)
    assert {c.strut for u in updates for c in u.changes} == {3} and found_within(updates, 150, 3)
    assert off(learner, geometric_parameters(poses.after)) < 80


def test_a_knocked_frame_is_told_from_the_struts(design):
    moved = np.array([2e-4, -1e-4, 5e-5, -1e-4, 3e-4, 2e-4])
    poses = stream(design, 4, 190, 150, moved=moved)
    learner, updates = learnt(design, poses)
    changes = [c for u in updates for c in u.changes]
    assert [c.kind for c in changes] == ["frame"] and changes[0].onset == 150
    assert (np.abs(changes[0].size - moved) < 4 * changes[0].sigma).all()
    assert (
        off(
            learner,
            geometric_parameters(poses.after)
            + parameter_changes_by_base_and_platform_frame_motion(poses.after)[:, :6] @ moved,
        )
        < 80
    )


def test_two_struts_at_once(design):
    jump = np.zeros(42)
    jump[36], jump[39] = 1e-4, -8e-5
    poses = stream(design, 5, 190, 150, jump)
    learner, updates = learnt(design, poses)
    assert (
        sorted(c.strut for u in updates for c in u.changes) == [1, 4]
        and off(learner, geometric_parameters(poses.after)) < 80
    )


def test_a_wrong_pose_is_left_out_entirely(design):
    poses = stream(design, 3, 180)
    T = poses.T.as_matrix().copy()
    T[150, :3, 3] += [2e-4, 0, 1e-4]
    learner, updates = learnt(design, replace(poses, T=RigidTransform.from_matrix(T)))
    assert event_rows(updates) == [(150, True, (), []), (151, False, (150,), [])]
    keep = np.arange(180) != 150
    clean, _ = learnt(design, replace(poses, T=poses.T[keep], commands=poses.commands[keep]))
    np.testing.assert_allclose(learner.p, clean.p, atol=1e-12)


def test_sessions_with_errors_of_their_own_add_up(design):
    """Two recordings, each with its own shared errors: together as a batch that is told so."""
    parts = [sampled(design, 2, count=150)[0], sampled(design, 2, count=150, noise_seed=77)[0]]
    learner = Online(design.mechanism, shared=6)
    for part in parts:
        if part is parts[1]:
            learner.new_session(6)
        for x, T, C, B in zip(part.commanded, part.T_base_platform, part.covariance, part.common):
            learner.update(x, T, C, B)
    apart = [np.concatenate([p.common * (k == 0), p.common * (k == 1)], axis=2) for k, p in enumerate(parts)]
    batch = identify_platform(
        Samples(
            np.arange(300),
            np.arange(300.0),
            np.concatenate([p.commanded for p in parts]),
            RigidTransform.concatenate([p.T_base_platform for p in parts]),
            np.concatenate([p.covariance for p in parts]),
            np.concatenate(apart),
        ),
        design.mechanism,
    )
    error = learner.p - geometric_parameters(batch.mechanism)
    assert error @ np.linalg.solve(batch.covariance, error) < 0.05
    np.testing.assert_allclose(np.diag(learner.covariance), np.diag(batch.covariance), rtol=5e-3)


def test_a_pose_that_is_wrong_early_is_left_out_entirely(design):
    """While the estimate still moves far with every pose, and all poses are linearised again before one is judged."""
    poses = stream(design, 3, 31)
    T = poses.T.as_matrix().copy()
    T[30, :3, 3] += [8e-4, 0, 4e-4]
    learner, updates = learnt(design, replace(poses, T=RigidTransform.from_matrix(T)))
    assert event_rows(updates) == [(30, True, (), [])]
    clean, _ = learnt(design, replace(poses, T=poses.T[:30], commands=poses.commands[:30]))
    assert np.abs((learner.p - clean.p) / np.sqrt(np.diag(clean.covariance))).max() < 0.01


@pytest.mark.parametrize("stop", [20, 60, 150, 151, 152])
def test_a_restart_changes_nothing(design, stop, tmp_path):
    """Stopped in quiet times, while poses wait to be linearised again, and while one is held."""
    jump = np.zeros(42)
    jump[38] = 1.5e-4
    poses = stream(design, 6, 170, 150, jump)
    through, updates = learnt(design, poses)
    learner, _ = learnt(design, replace(poses, commands=poses.commands[:stop], T=poses.T[:stop]))
    learner.save(tmp_path / "state.json")
    resumed, after = learnt(
        design, replace(poses, commands=poses.commands[stop:], T=poses.T[stop:]), Online.load(tmp_path / "state.json")
    )
    assert event_rows(after) == [line for line in event_rows(updates) if line[0] >= stop] and not list(
        tmp_path.glob("*.part")
    )
    np.testing.assert_allclose(resumed.p, through.p, atol=1e-10)
    np.testing.assert_allclose(resumed.covariance, through.covariance, atol=1e-16)


def test_a_refused_pose_leaves_the_state_alone(design):
    poses = stream(design, 1, 40)
    learner, _ = learnt(design, poses)
    before, number = learner.p.copy(), learner.number
    with pytest.raises(RigError, match="close on no pose"):
        learner.update([0.1, 5.0, 0.1, 5.0, 0.1, 5.0], poses.T[0], COVARIANCE)
    with pytest.raises(RigError, match="covariance is invalid"):
        learner.update(poses.commands[0], poses.T[0], -COVARIANCE)
    with pytest.raises(ValueError, match=r"expected a command \(6,\)"):
        learner.update(poses.commands[0][:5], poses.T[0], COVARIANCE)
    np.testing.assert_array_equal(learner.p, before)
    assert learner.number == number


@pytest.mark.parametrize(
    "text, says",
    [
        ("{", "cut off"),
        ("[]", "no state"),
        ('{"schema": "online/9"}', "online/9"),
        ('{"schema": "online/1"}', "nominal"),
    ],
)
def test_what_is_no_state_is_refused(tmp_path, text, says):
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(FileError, match=says):
        Online.load(tmp_path / "s.json")
    with pytest.raises(FileError, match="no such file"):
        Online.load(tmp_path / "typo.json")


def test_a_long_run_keeps_no_old_states(design):
    """Going back takes the last few states; the ones before are let go, or a day of poses would fill the memory."""
    poses = stream(design, 4, 140)
    learner, _ = learnt(design, replace(poses, commands=poses.commands[:130], T=poses.T[:130]))
    old = weakref.ref(learner.state.estimate.S)
    learner, _ = learnt(design, replace(poses, commands=poses.commands[130:], T=poses.T[130:]), learner)
    gc.collect()
    assert old() is None


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("p", lambda v: v[:41], "p must have 42 numbers, got 41 entries"),
        ("p", lambda v: [*v[:41], 1e308], "p.42. is too large"),
        ("scatter", lambda v: [], "scatter must have 6 numbers, got 0 entries"),
        ("s", lambda v: [0.0], "S must have 43xn|S must have 43x44"),
        ("S", lambda v: v[:5], "S must have 42x43"),
        ("S", lambda v: [[0.0] * 43] * 42, "no triangle"),
        ("root", lambda v: v[0], "root.1. must have"),
        ("recent", lambda v: [v[0][:5]], "lists of 6"),
        ("recent", lambda v: [[*v[0][:2], [[1.0]], *v[0][3:]]], "recent.1.3 must have 3x3"),
        ("recent", lambda v: v * 9, "recent has"),
        ("held", lambda v: None, "held must be a list"),
        ("number", lambda v: 2**70, "number must be"),
        ("first", lambda v: [[0, "x", 0, 0, 0, 0]], "first.1.2 must have 6 numbers"),
        ("recent", lambda v: [[*v[0][:4], [[0.0] * 6] * 6, v[0][5]]], "cannot be replayed"),
    ],
)
def test_arrays_of_a_state_are_checked_before_compiled_code_takes_them(design, tmp_path, key, value, says):
    learner, _ = learnt(design, stream(design, 3, 5))
    learner.save(tmp_path / "s.json")
    tree = json.loads((tmp_path / "s.json").read_text())
    (tmp_path / "s.json").write_text(json.dumps(tree | {key: value(tree[key])}))
    with pytest.raises(FileError, match=says):
        Online.load(tmp_path / "s.json")


@pytest.mark.slow
def test_two_hundred_missed_steps_and_a_hundred_thousand_quiet_poses(design):
    found = 0
    for seed in range(200):
        poses, _, updates, strut, _ = missed_step(design, seed)
        found += found_within(updates, poses.at, strut)
    assert found >= 196
    false = sum(len(u.changes) for seed in range(100) for u in learnt(design, stream(design, 5000 + seed, 1000))[1])
    assert false <= 1
