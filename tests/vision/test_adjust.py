"""The adjustment: its Jacobian, its optimum, its gauge, and what it leaves alone."""


import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from rig.errors import NotEnoughData
from rig.pose import difference, exp
from tests.vision.scenes import known, scene
from vision import adjust as adjusting
from vision.adjust import adjust
from vision.predict import State, predict


@pytest.fixture(scope="module")
def setting(design):
    return scene(design, 1, frames=6)


def start(stated, true, T, seed=0):
    rng = np.random.default_rng(seed)
    return State(known(stated, true).cameras, T * exp(1e-4 * rng.normal(size=(len(T), 6))), {})


def whitened(observations, state):
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance))
    return (W @ (observations.uv - predict(observations, state)[0])[..., None])[..., 0]


@pytest.mark.parametrize("moving", [False, True])
def test_jacobian_agrees_with_differences(setting, moving):
    observations, stated, true, T = setting
    state = start(stated, true, T)
    if moving:
        state = State(state.cameras, state.platform, {1: RigidTransform.concatenate([state.cameras[1].pose] * 6)})
    layout = adjusting._layout(observations, state, ("poses", "lenses"))
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance))
    _, blocks = adjusting._linearise(observations, state, layout, W)
    rng = np.random.default_rng(1)
    shared, local = rng.normal(size=layout.shared), rng.normal(size=(6, layout.local))
    h = 1e-5
    up, down = (whitened(observations, adjusting._move(state, layout, s * h * shared, s * h * local)) for s in (1, -1))
    expected = np.zeros_like(up)
    for i, (first, J) in blocks.items():
        own, common = adjusting._columns(i, layout)
        rows = slice(first, first + len(J))
        step = np.concatenate([local[observations.frame[rows]][:, own], np.tile(shared[common], (len(J), 1))], axis=1)
        expected[rows] = (J @ step[..., None])[..., 0]
    np.testing.assert_allclose(-(up - down) / (2 * h), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_optimum_equals_scipys(setting):
    observations, stated, true, T = setting
    state = start(stated, true, T)
    result = adjust(observations, state)
    layout = adjusting._layout(observations, state, ("poses", "lenses"))

    def residual(p):
        moved = adjusting._move(result.state, layout, p[: layout.shared], p[layout.shared :].reshape(6, 6))
        offset = adjusting._lens_offset(moved.cameras, state.cameras, layout) / layout.scale
        return np.r_[whitened(observations, moved).ravel(), (layout.prior * offset)[layout.prior > 0]]

    zero = np.zeros(layout.shared + 36)
    other = least_squares(residual, zero, method="trf", x_scale="jac", max_nfev=5)
    assert result.cost == pytest.approx(2 * other.cost, rel=1e-6)
    assert np.abs(residual(zero)).sum() > 0


def test_what_is_held_stays(setting):
    observations, stated, true, T = setting
    state = start(stated, true, T)
    lenses = adjust(observations, state, free=("lenses",))
    poses = adjust(observations, state, free=("poses",))
    none = adjust(observations, state, free=())
    for before, a, b, c in zip(state.cameras, lenses.state.cameras, poses.state.cameras, none.state.cameras):
        assert a.pose is before.pose and (b.matrix == before.matrix).all() and c is before
        assert (a.matrix != before.matrix).any() and np.abs(difference(before.pose, b.pose)).max() > 0
    assert none.platform_common.shape == (6, 6, 0)


def test_without_base_targets_the_stated_cameras_hold_the_frame(setting):
    observations, stated, true, T = setting
    platform = observations.take(observations.on_platform)
    state = start(stated, true, T)
    result = adjust(platform, state)
    moves = np.zeros(6)
    for before, after in zip(state.cameras, result.state.cameras):
        step = difference(before.pose, after.pose)
        R = before.pose.rotation.as_matrix()
        moves += np.r_[R @ step[:3], R @ step[3:]]
    np.testing.assert_allclose(moves, 0, atol=1e-6)
    one = platform.take(platform.camera == 0)
    alone = adjust(one, state)
    assert np.abs(difference(state.cameras[0].pose, alone.state.cameras[0].pose)).max() < 1e-9


def test_a_term_that_nothing_shows_stays_put(setting):
    """Corners in the middle of the image alone say nothing of k3."""
    observations, stated, true, T = setting
    centre = np.linalg.norm(observations.uv - [640, 512], axis=1) < 250
    state = start(stated, true, T)
    result = adjust(observations.take(centre), state)
    sigma = dict(zip(result.shared_names, np.sqrt(np.diag(result.shared_covariance))))
    for before, after in zip(state.cameras, result.state.cameras):
        assert abs(after.distortion[4] - before.distortion[4]) < 0.05
        assert sigma[after.name, "k3"] == pytest.approx(adjusting.TERM_PRIOR["k3"], rel=0.05)


def test_moving_camera_is_found_in_every_frame(setting):
    observations, stated, true, T = setting
    state = start(stated, true, T)
    state = State(state.cameras, state.platform, {0: RigidTransform.concatenate([state.cameras[0].pose] * 6) * exp(1e-3 * np.ones((6, 6)))})
    result = adjust(observations, state)
    wander = difference(RigidTransform.concatenate([true.cameras[0].pose] * 6), result.state.moving[0])
    assert np.abs(wander[:, :3]).max() < 2e-3 and np.abs(wander).max() > 0


def test_too_few_corners_are_refused(setting):
    observations, stated, true, T = setting
    with pytest.raises(NotEnoughData, match="cannot determine"):
        adjust(observations.take(np.arange(5)), start(stated, true, T))


def test_free_takes_what_it_knows(setting):
    observations, stated, true, T = setting
    with pytest.raises(ValueError, match="poses"):
        adjust(observations, start(stated, true, T), free=("targets",))
