"""The adjustment: its Jacobian, its optimum, its gauge, and what it leaves alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from rig.errors import NotEnoughData
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.pose import exp, log, pose_difference
from tests.vision.drawn_observations import known, scene
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import determinacy_of_adjusted_unknowns
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    UnknownName,
    estimate_after_step,
    estimate_offset_from_stated,
    rigid_transform_aligning_points,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import (
    TERM_PRIOR,
    adjustment_unknowns_and_start_estimate,
)
from vision.bundle.bundle_adjustment import adjust_bundle
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import whitened_residuals_and_derivatives
from vision.corner_observations_and_merging import correlations_of_whitened_marker_corners, whitener_of_observations
from vision.marker_corner_prediction import State, marker_map, predict_corners


@pytest.fixture(scope="module")
def setting(design):
    return scene(design, 1, frames=6)


def start(stated, true, T, seed=0):
    rng = np.random.default_rng(seed)
    return State(known(stated, true).cameras, T * exp(1e-4 * rng.normal(size=(len(T), 6))), {})


def whitened(observations, state):
    return whitener_of_observations(observations)(observations.uv - predict_corners(observations, state)[0])


EVERYTHING = ("poses", "lenses", "markers", "targets")


def with_markers(state, design, size=1e-3):
    """The state with markers whose places are off by `size` (m, and five times as many rad)."""
    markers = marker_map(design)
    xi = size * np.random.default_rng(5).normal(size=(len(markers.id), 6)) * [1, 1, 1, 5, 5, 5]
    return replace(state, markers=replace(markers, T_body_marker=markers.T_body_marker * exp(xi)))


@pytest.mark.parametrize("free", [("poses", "lenses"), EVERYTHING, ("markers",), ("targets",)])
@pytest.mark.parametrize("moving, correlated", [(False, False), (True, False), (False, True)])
def test_jacobian_agrees_with_differences(setting, moving, correlated, free):
    observations, stated, true, T = setting
    if correlated:
        root = np.random.default_rng(8).normal(size=(len(observations) // 4, 8, 8)) + 3 * np.eye(8)
        observations = replace(
            observations,
            correlation=correlations_of_whitened_marker_corners(root @ np.swapaxes(root, 1, 2)).reshape(-1, 2, 8),
        )
        observations = observations.take(np.arange(len(observations)) % 7 != 0)
    state = with_markers(start(stated, true, T), stated)
    if moving:
        state = replace(state, moving={1: RigidTransform.concatenate([state.cameras[1].pose] * 6)})
    u, estimate = adjustment_unknowns_and_start_estimate(
        observations, state, replace(state, markers=marker_map(stated)), free
    )
    rng = np.random.default_rng(1)
    estimate = estimate_after_step(
        estimate, u, 1e-3 * rng.normal(size=u.shared), np.zeros((6, u.local))
    )  # not where moves are still zero
    _, found = whitened_residuals_and_derivatives(observations, estimate, u, whitener_of_observations(observations))
    shared, local = rng.normal(size=u.shared), rng.normal(size=(6, u.local))
    h = 1e-5
    up, down = (
        whitened(observations, estimate_after_step(estimate, u, s * h * shared, s * h * local).state) for s in (1, -1)
    )
    expected = np.zeros_like(up)
    for d in found.values():
        frame, marker = observations.frame[d.rows], observations.marker[d.rows]
        expected[d.rows] = (d.own @ local[frame][:, d.own_columns, None])[..., 0] + (
            d.shared @ shared[d.shared_columns[marker]][..., None]
        )[..., 0]
    np.testing.assert_allclose(-(up - down) / (2 * h), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("free", [("poses", "lenses"), EVERYTHING])
def test_optimum_equals_scipys(setting, free):
    observations, stated, true, T = setting
    observations = observations.take((observations.frame < 3) & (observations.camera < 2))
    state = replace(start(stated, true, T), markers=marker_map(stated))
    result = adjust_bundle(observations, state, free)
    u, estimate = adjustment_unknowns_and_start_estimate(observations, result.state, state, free)

    def residual(p):
        moved = estimate_after_step(estimate, u, u.basis @ p[: u.basis.shape[1]], p[u.basis.shape[1] :].reshape(6, 6))
        return np.r_[
            whitened(observations, moved.state).ravel(),
            (u.prior * estimate_offset_from_stated(moved, state, u))[u.prior > 0],
        ]

    zero = np.zeros(u.basis.shape[1] + 36)
    other = least_squares(residual, zero, method="trf", x_scale="jac", max_nfev=2)
    assert result.cost == pytest.approx(2 * other.cost, rel=1e-6)
    assert np.abs(residual(zero)).sum() > 0


def test_markers_and_targets_off_their_places_are_found(setting):
    """Bodies' frames stay where the stated places hold them; what moved is found within its stated uncertainty."""
    observations, stated, true, T = setting
    true_state = with_markers(start(stated, true, T), stated, 3e-4)
    uv, _ = predict_corners(observations, true_state)
    noise = 0.04 * np.random.default_rng(2).normal(size=uv.shape)
    shifted = replace(observations, uv=uv + noise, covariance=np.tile(0.04**2 * np.eye(2), (len(uv), 1, 1)))
    state = replace(start(stated, true, T, seed=3), markers=marker_map(stated))
    result = adjust_bundle(shifted, state, ("poses", "lenses", "markers"))
    assert result.cost / result.dof == pytest.approx(1, abs=4 * np.sqrt(2 / result.dof))
    found, before, seen = result.state.markers, state.markers, result.unknowns.seen
    for on in (False, True):
        rows = seen[before.on_platform[seen] == on]
        gone = (found.corners - before.corners)[rows].reshape(-1, 3)
        arms = before.corners[rows].reshape(-1, 3)
        assert (
            np.abs(gone.sum(axis=0)).max() < 1e-12
            and np.abs(np.cross(found.corners[rows].reshape(-1, 3), arms).sum(axis=0)).max() < 1e-12
        )
    freed = adjust_bundle(
        shifted, true_state, ("poses", "lenses", "markers"), stated=state
    )  # another start, the same optimum
    np.testing.assert_allclose(freed.state.markers.corners[seen], found.corners[seen], atol=1e-7)
    shift = {
        on: rigid_transform_aligning_points(
            true_state.markers.corners[rows].reshape(-1, 3), before.corners[rows].reshape(-1, 3)
        )
        for on in (False, True)
        for rows in [seen[before.on_platform[seen] == on]]
    }
    columns = np.concatenate([np.arange(c.start, c.stop) for c in result.unknowns.markers.values()])
    scale = result.unknowns.scale[columns]
    errors = (
        np.concatenate(
            [
                log(
                    (shift[bool(before.on_platform[row])] * true_state.markers.T_body_marker[row]).inv()
                    * found.T_body_marker[row]
                )
                for row in result.unknowns.markers
            ]
        )
        / scale
    )
    values, vectors = np.linalg.eigh(result.shared_covariance[np.ix_(columns, columns)] / np.outer(scale, scale))
    free = values > 1e-12 * values.max()
    assert free.sum() == len(columns) - 12  # the datums take six of each body
    assert np.mean((vectors.T @ errors)[free] ** 2 / values[free]) == pytest.approx(1, abs=4 * np.sqrt(2 / free.sum()))
    fits = adjust_bundle(shifted, state, ("poses", "lenses", "targets"))
    assert fits.cost > 2 * result.cost and all(row not in fits.unknowns.markers for row in seen)


def test_what_is_held_stays(setting):
    observations, stated, true, T = setting
    state = start(stated, true, T)
    lenses = adjust_bundle(observations, state, free=("lenses",))
    poses = adjust_bundle(observations, state, free=("poses",))
    none = adjust_bundle(observations, state, free=())
    for before, a, b, c in zip(state.cameras, lenses.state.cameras, poses.state.cameras, none.state.cameras):
        assert a.pose is before.pose and (b.matrix == before.matrix).all() and c is before
        assert (a.matrix != before.matrix).any() and np.abs(pose_difference(before.pose, b.pose)).max() > 0
    assert none.platform_common.shape == (6, 6, 0)


def test_without_base_targets_the_stated_cameras_hold_the_frame(setting):
    observations, stated, true, T = setting
    platform = observations.take(observations.on_platform)
    state = start(stated, true, T)
    result = adjust_bundle(platform, state)
    moves = np.zeros(6)
    for before, after in zip(state.cameras, result.state.cameras):
        step = pose_difference(before.pose, after.pose)
        R = before.pose.rotation.as_matrix()
        moves += np.r_[R @ step[:3], R @ step[3:]]
    np.testing.assert_allclose(moves, 0, atol=1e-6)
    one = platform.take(platform.camera == 0)
    alone = adjust_bundle(one, state)
    assert np.abs(pose_difference(state.cameras[0].pose, alone.state.cameras[0].pose)).max() < 1e-9


def test_a_term_that_nothing_shows_stays_put(setting):
    """Corners in the middle of the image alone say nothing of k3."""
    observations, stated, true, T = setting
    centre = np.linalg.norm(observations.uv - [640, 512], axis=1) < 250
    state = start(stated, true, T)
    result = adjust_bundle(observations.take(centre), state)
    sigma = dict(zip(result.shared_names, np.sqrt(np.diag(result.shared_covariance))))
    for before, after in zip(state.cameras, result.state.cameras):
        assert abs(after.distortion[4] - before.distortion[4]) < 0.05
        assert sigma[UnknownName(Place("camera", after.name), "k3")] == pytest.approx(TERM_PRIOR["k3"], rel=0.05)
    weak = determinacy_of_adjusted_unknowns(result).undetermined
    assert {name for _, names in weak for name in names} >= {f"{camera.name} k3" for camera in state.cameras}
    assert "not determined by this recording" in "\n".join(determinacy_of_adjusted_unknowns(result).lines())


def test_moving_camera_is_found_in_every_frame(setting):
    observations, stated, true, T = setting
    state = start(stated, true, T)
    state = State(
        state.cameras,
        state.platform,
        {0: RigidTransform.concatenate([state.cameras[0].pose] * 6) * exp(1e-3 * np.ones((6, 6)))},
    )
    result = adjust_bundle(observations, state)
    wander = pose_difference(RigidTransform.concatenate([true.cameras[0].pose] * 6), result.state.moving[0])
    assert np.abs(wander[:, :3]).max() < 2e-3 and np.abs(wander).max() > 0


def test_too_few_corners_are_refused(setting):
    observations, stated, true, T = setting
    with pytest.raises(NotEnoughData, match="cannot determine"):
        adjust_bundle(observations.take(np.arange(5)), start(stated, true, T))


def test_free_takes_what_it_knows(setting):
    observations, stated, true, T = setting
    with pytest.raises(ValueError, match="poses"):
        adjust_bundle(observations, start(stated, true, T), free=("faces",))
    with pytest.raises(ValueError, match="markers"):
        adjust_bundle(observations, start(stated, true, T), free=("targets",))
