"""Repeats of base corners taken as one: the same optimum, cost and normal equations, at a fraction of the corners."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vision.drawn_observations import known, scene
from vision.bundle import bundle_adjustment as adjusting
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import estimate_offset_from_stated
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    whitened_residuals_and_derivatives,
)
from vision.corner_observations_and_merging import (
    correlations_of_whitened_marker_corners,
    merged_corners_and_lost_squares,
    whitener_of_observations,
)
from vision.marker_corner_prediction import State


@pytest.fixture(scope="module")
def setting(design):
    observations, stated, true, T = scene(design, 1, frames=6)
    rng = np.random.default_rng(0)
    A = rng.normal(size=(len(observations), 2, 2))
    uneven = replace(
        observations,
        covariance=observations.covariance * (1 + rng.uniform(size=(len(A), 1, 1))) + 1e-4 * A @ np.swapaxes(A, 1, 2),
    )
    return uneven, State(known(stated, true).cameras, T, {})


def test_cost_and_normal_equations_are_the_same(setting):
    observations, state = setting
    few, spare = merged_corners_and_lost_squares(observations, state)
    assert len(few) < 0.8 * len(observations) and (~few.on_platform).sum() * 4 < (~observations.on_platform).sum()
    u, estimate = adjustment_unknowns_and_start_estimate(observations, state, state, ("poses", "lenses"))
    both = []
    for o, rest in ((observations, 0.0), (few, spare)):
        residual, derivatives = whitened_residuals_and_derivatives(o, estimate, u, whitener_of_observations(o))
        both.append(
            (
                normal_equations(o, derivatives, u, estimate_offset_from_stated(estimate, state, u)),
                float((residual**2).sum()) + rest,
            )
        )
    (whole, cost), (short, same) = both
    assert same == pytest.approx(cost, rel=1e-12)
    for name in ("local", "cross", "shared", "own", "common"):
        np.testing.assert_allclose(
            getattr(short, name), getattr(whole, name), rtol=1e-9, atol=1e-9 * np.abs(getattr(whole, name)).max()
        )


def test_an_adjustment_is_the_same(setting, monkeypatch):
    observations, state = setting
    quick = adjusting.adjust_bundle(observations, state)
    monkeypatch.setattr(adjusting, "merged_corners_and_lost_squares", lambda observations, state: (observations, 0.0))
    slow = adjusting.adjust_bundle(observations, state)
    assert quick.cost == pytest.approx(slow.cost, rel=1e-11) and quick.dof == pytest.approx(slow.dof, rel=1e-9)
    np.testing.assert_allclose(quick.state.platform.as_matrix(), slow.state.platform.as_matrix(), atol=1e-10)
    np.testing.assert_allclose(quick.platform_given_cameras, slow.platform_given_cameras, rtol=1e-8, atol=1e-16)
    np.testing.assert_allclose(quick.whitened, slow.whitened, atol=1e-5)


def test_what_hangs_together_and_what_moves_stays_as_it_is(setting):
    observations, state = setting
    m = -(-len(observations) // 4)
    tied = replace(
        observations,
        correlation=correlations_of_whitened_marker_corners(np.tile(np.eye(8), (m, 1, 1))).reshape(-1, 2, 8)[
            : len(observations)
        ],
    )
    assert merged_corners_and_lost_squares(tied, state) == (tied, 0.0)
    moving = replace(state, moving={0: state.platform})
    few, _ = merged_corners_and_lost_squares(observations, moving)
    for camera, same in ((0, True), (1, False)):
        assert ((few.camera == camera).sum() == (observations.camera == camera).sum()) == same
