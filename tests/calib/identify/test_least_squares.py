"""The engine: optimum, covariance, priors, constraints, shared errors, robustness, and what it refuses."""

import numpy as np
import pytest

from calib.identify.bounded_and_robust_least_squares_fit import (
    Linear,
    bounded_step_and_covariance,
    fit_least_squares,
    parameter_visibility,
)
from rig.errors import NotEnoughData, RigError


def curve(rng, true, n=40, common=0.0):
    """Three readings of a saturating curve at a time: (linearise, noise added) for parameters true (2,)."""
    x = rng.uniform(0.2, 3, (n, 3))
    seen = true[0] * (1 - np.exp(-true[1] * x)) + 0.01 * rng.normal(size=(n, 3)) + common * rng.normal()

    def linearise(p):
        decay = np.exp(-p[1] * x)
        J = np.stack([1 - decay, p[0] * x * decay], axis=-1) / 0.01
        return Linear((seen - p[0] * (1 - decay)) / 0.01, J, np.full((n, 3, 1 if common else 0), common / 0.01))

    return linearise, seen


FREE = np.zeros(2), np.full(2, np.inf)


def test_estimates_scatter_as_claimed_and_the_optimum_is_one():
    true, z = np.array([2.0, 0.8]), []
    for seed in range(200):
        linearise, _ = curve(np.random.default_rng(seed), true, common=0.02)
        found = fit_least_squares(linearise, [1.5, 0.5], *FREE)
        z.append((found.parameters - true) / np.sqrt(np.diag(found.covariance)))
    assert np.abs(np.mean(z, axis=0)).max() < 4 / np.sqrt(200) and np.std(z) == pytest.approx(1, abs=0.12)
    linear = linearise(found.parameters)
    left = linear.residual - linear.common @ found.shared
    gradient = np.einsum("nmk,nm->k", linear.jacobian, left)
    assert gradient @ found.covariance @ gradient < 1e-4  # within a hundredth of a standard deviation
    np.testing.assert_allclose(found.root.T @ found.root, np.linalg.inv(found.covariance), rtol=1e-9)


def test_a_prior_weighs_as_one_more_reading():
    linearise, _ = curve(np.random.default_rng(0), np.array([2.0, 0.8]))
    free = fit_least_squares(linearise, [1.5, 0.5], *FREE)
    held = fit_least_squares(linearise, [1.5, 0.5], [3.0, 0.0], [1e-9, np.inf])
    assert held.parameters[0] == pytest.approx(3.0, abs=1e-6) and held.parameters[1] != pytest.approx(
        free.parameters[1], abs=0.05
    )
    both = fit_least_squares(
        linearise, [1.5, 0.5], [free.parameters[0] + 1e-3, 0.0], [np.sqrt(free.covariance[0, 0]), np.inf]
    )
    assert both.covariance[0, 0] == pytest.approx(free.covariance[0, 0] / 2, rel=0.05)


def test_a_wrong_block_is_sorted_out():
    linearise, seen = curve(np.random.default_rng(0), np.array([2.0, 0.8]))
    clean = fit_least_squares(linearise, [1.5, 0.5], *FREE, inliers=np.arange(40) != 7)
    seen[7] += 5.0
    found = fit_least_squares(linearise, [1.5, 0.5], *FREE, robust=True)
    assert np.flatnonzero(~found.inliers).tolist() == [7]
    np.testing.assert_allclose(found.parameters, clean.parameters, atol=1e-6)


def test_what_nothing_holds_is_refused():
    x = np.random.default_rng(0).normal(size=(20, 3))

    def same(p):
        return Linear(x - p.sum(), np.ones((20, 3, 2)), np.zeros((20, 3, 0)))

    with pytest.raises(NotEnoughData, match="1 of 2 directions open"):
        fit_least_squares(same, [0, 0], *FREE)
    found = fit_least_squares(same, [0.0, 0.0], [0.0, 0.0], [1.0, 1.0])
    assert found.parameters[0] == pytest.approx(found.parameters[1])
    assert parameter_visibility(found.root, np.ones(2)).condition > 1e12


def test_steps_that_do_not_settle_are_refused():
    def uphill(p):
        return Linear(np.sign(p)[None] * np.ones((1, 1)), np.full((1, 1, 1), 1.0), np.zeros((1, 1, 0)))

    with pytest.raises(RigError, match="did not settle"):
        fit_least_squares(uphill, [0.5], [0.0], [np.inf])


def test_a_step_that_a_bound_and_a_sum_leave_no_room_for_is_none():
    bounds, values = np.array([[0.0, 1.0], [0.0, 1.0]]), np.array([1.0, 0.5])
    step, _ = bounded_step_and_covariance(np.array([0.3, -0.3]), np.eye(2), values, bounds, np.ones((1, 2)))
    assert step.tolist() == [0.0, 0.0]
