"""A whole recording: covariances held to the scatter seen, outliers and lost frames reported, nothing filled in."""

from dataclasses import replace

import numpy as np
import pytest

from rig.errors import NotEnoughData
from rig.model.pose import exp, pose_difference
from tests.vision.drawn_observations import known, nees, scene, standing
from vision.corner_observations_and_merging import correlations_of_whitened_marker_corners, whitener_of_observations
from vision.marker_corner_prediction import marker_map
from vision.recording_adjustment_with_hand_and_stages import measure_observations


def joint_chi2(m, errors):
    """Chi-square of all poses of a recording at once, shared errors and all (6 per pose is right)."""
    own = m.covariance - m.common @ np.swapaxes(m.common, 1, 2)
    whitener = np.linalg.inv(np.linalg.cholesky(own))
    e, C = (whitener @ errors[..., None]).ravel(), (whitener @ m.common).reshape(-1, m.common.shape[2])
    return e @ e - (e @ C) @ np.linalg.solve(np.eye(C.shape[1]) + C.T @ C, C.T @ e)


@pytest.mark.slow  # by default with cameras adjusted, which takes in all of it
def test_covariance_is_true_with_cameras_known(design):
    observations, stated, true, T = scene(design, 21, frames=1500)
    m = measure_observations(observations, known(stated, true), marker_map(design), free=())
    assert len(m.frames) == 1500
    assert m.noise == pytest.approx(0.04, rel=0.01)
    assert np.mean(nees(pose_difference(m.T_base_platform, T), m.covariance)) == pytest.approx(6, rel=0.05)


def recordings(design, seeds, frames):
    for seed in seeds:
        observations, stated, _, T = scene(design, seed, frames=frames)
        m = measure_observations(observations, stated, marker_map(design))
        yield m, pose_difference(m.T_base_platform, T)


@pytest.mark.slow
def test_covariance_is_true_with_cameras_adjusted(design):
    """The poses of a recording share the cameras' error; taken together, 40 recordings leave 1 % of room for chance."""
    chi2, count = 0.0, 0
    for m, errors in recordings(design, range(100, 140), 40):
        chi2 += joint_chi2(m, errors)
        count += len(errors)
    assert chi2 / count == pytest.approx(6, rel=0.05)


@pytest.mark.slow
def test_covariance_of_each_pose_is_true_over_many_recordings(design):
    """Pose by pose: a recording's shared error is one draw, so it takes hundreds of them to hold 5 %."""
    average = [np.mean(nees(errors, m.covariance)) for m, errors in recordings(design, range(1000, 1600), 24)]
    assert np.mean(average) == pytest.approx(6, rel=0.05)


def test_stated_covariance_is_brought_to_the_scatter_seen(design):
    observations, stated, true, T = scene(design, 2, frames=40, noise=0.08)
    m = measure_observations(
        replace(observations, stated=True, covariance=0.01**2 * np.tile(np.eye(2), (len(observations), 1, 1))),
        stated,
        marker_map(design),
    )
    assert m.noise == pytest.approx(0.08, rel=0.03) and m.factor == pytest.approx(64, rel=0.06)


@pytest.mark.slow
def test_errors_that_come_back_in_every_frame_are_not_averaged_away(design):
    ratios = []
    for seed in range(30, 42):
        observations, stated, true, T = scene(design, seed, frames=30, noise=0.01)
        m = measure_observations(standing(observations, np.random.default_rng(seed), 0.03), stated, marker_map(design))
        assert m.standing == pytest.approx(0.03, rel=0.35)
        ratios.append(joint_chi2(m, pose_difference(m.T_base_platform, T)) / len(T))
    assert 4 < np.mean(ratios) < 8


def test_outliers_are_set_aside_and_leave_no_trace(design):
    observations, stated, true, T = scene(design, 4, frames=20)
    rng = np.random.default_rng(0)
    rows = rng.choice(len(observations), len(observations) // 50, replace=False)
    poses = []
    for size in (3.0, 300.0):
        uv = observations.uv.copy()
        uv[rows] += size * np.sign(rng.normal(size=(len(rows), 2)))
        m = measure_observations(replace(observations, uv=uv), stated, marker_map(design))
        assert not m.inliers[rows].any() and m.inliers.sum() >= len(observations) - len(rows) - 3
        poses.append(m.T_base_platform)
    np.testing.assert_allclose(pose_difference(*poses), 0, atol=1e-7)


def test_a_frame_that_cannot_be_solved_is_reported_and_not_filled_in(design):
    observations, stated, true, T = scene(design, 6, frames=10)
    on, frame = observations.on_platform, observations.frame
    first = np.flatnonzero(on & (frame == 3))[0]
    lonely = (observations.marker == observations.marker[first]) & (observations.camera == observations.camera[first])
    retained = observations.take(~(on & (frame == 2)) & ~(on & (frame == 3) & ~lonely))
    m = measure_observations(retained, stated, marker_map(design))
    assert m.frames.tolist() == [0, 1, 4, 5, 6, 7, 8, 9]
    assert "no marker" in m.unsolved[2] and "single sighting" in m.unsolved[3]
    assert np.abs(pose_difference(m.T_base_platform, T[m.frames])).max() < 1e-3


@pytest.mark.parametrize("left", [0, 1])
def test_a_camera_that_the_base_does_not_place_joins_by_the_others_poses(design, left):
    """It sees no base marker, or one, and stands 160 mm and 10 degrees from its stated pose: the others tell
    where.
    """
    observations, stated, true, _ = scene(design, 6, frames=8)
    o, first = observations, stated.cameras[0]
    base = np.unique(o.marker[(o.camera == 0) & ~o.on_platform])
    seen = observations.take((o.camera != 0) | o.on_platform | np.isin(o.marker, base[:left]))
    away = replace(first, pose=first.pose * exp(np.array([0.12, -0.08, 0.07, 0.1, -0.1, 0.1])))
    m = measure_observations(seen, replace(stated, cameras=(away, *stated.cameras[1:])), marker_map(design))
    off = m.design.cameras[0].pose.inv() * true.cameras[0].pose
    assert (
        len(m.frames) == 8
        and m.inliers.mean() > 0.98
        and np.linalg.norm(off.translation) < 1e-3
        and off.rotation.magnitude() < 6e-3
    )


def test_nothing_solved_is_an_error_with_reasons(design):
    observations, stated, *_ = scene(design, 6, frames=3)
    with pytest.raises(NotEnoughData, match="none of 3 frames.*no marker"):
        measure_observations(observations.take(~observations.on_platform), stated, marker_map(design))


def test_a_cube_turned_round_is_cast_out_whole(design):
    """Two faces exchanged in every frame: the cube contradicts the others and is not averaged in."""
    observations, stated, true, T = scene(design, 8, frames=12)
    marker = observations.marker.copy()
    marker[observations.marker == 0], marker[observations.marker == 2] = 2, 0
    markers = marker_map(design)
    points = markers.corners[marker, observations.corner]
    m = measure_observations(replace(observations, marker=marker, points=points), stated, markers)
    swapped = np.isin(observations.marker, (0, 2))
    assert not m.inliers[swapped].any() and m.inliers[~swapped].mean() > 0.99
    assert np.abs(pose_difference(m.T_base_platform, T)).max() < 5e-4


def correlated(observations, rng, sigma):
    """Observations whose corners' errors are correlated within each sighting, as those of a marker fitted as a whole
    are.
    """
    o = observations
    first = np.flatnonzero(o.corner == 0)
    assert (o.corner.reshape(-1, 4) == range(4)).all() and len(first) * 4 == len(o)
    spread = np.eye(4) - 0.2 * np.ones((4, 4))  # what moves all four corners alike is known four times better
    factor = np.kron(spread, np.eye(2)) * sigma
    uv = o.uv + (factor @ rng.normal(size=(len(first), 8, 1))).reshape(-1, 2)
    C = np.tile(factor @ factor.T, (len(first), 1, 1))
    own = np.stack([C[:, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(4)], axis=1).reshape(-1, 2, 2)
    return replace(
        o, uv=uv, covariance=own, correlation=correlations_of_whitened_marker_corners(C).reshape(-1, 2, 8), stated=True
    )


@pytest.mark.slow
def test_corners_of_a_marker_are_weighed_together(design):
    together, apart, gain = [], [], []
    for seed in range(60, 76):
        observations, stated, _, T = scene(design, seed, frames=24, noise=0.0)
        noisy = correlated(observations, np.random.default_rng(seed), 0.04)
        m = measure_observations(noisy, stated, marker_map(design))
        without = measure_observations(replace(noisy, correlation=None), stated, marker_map(design))
        errors = [pose_difference(one.T_base_platform, T) for one in (m, without)]
        together.append(joint_chi2(m, errors[0]) / len(T))
        apart.append(joint_chi2(without, errors[1]) / len(T))
        gain.append((errors[1] ** 2).mean(axis=0) / (errors[0] ** 2).mean(axis=0))
    assert np.mean(together) == pytest.approx(6, rel=0.1)
    assert np.mean(apart) < 4.5  # what leaving the correlation out would state too wide
    assert np.exp(np.mean(np.log(gain))) > 1


def test_a_corner_set_aside_leaves_the_others_their_own_correlation(design):
    observations, *_ = scene(design, 3, frames=2, noise=0.0)
    noisy = correlated(observations, np.random.default_rng(0), 0.04)
    W = whitener_of_observations(noisy.take(np.arange(len(noisy)) % 4 != 1))
    R = np.linalg.inv(W.mixing[0].T @ W.mixing[0])
    full = np.linalg.inv(whitener_of_observations(noisy).mixing[0].T @ whitener_of_observations(noisy).mixing[0])
    rows = [0, 1, 4, 5, 6, 7]
    np.testing.assert_allclose(R[np.ix_(rows, rows)], full[np.ix_(rows, rows)], atol=1e-12)
    np.testing.assert_allclose(R[2:4], np.eye(8)[2:4], atol=1e-12)
