"""The 42: Jacobians, exactness without noise, z-scores with it, robustness, and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.models.platform.platform_identification import PRIOR, identify_platform, pose_parameter_jacobian
from rig.errors import NotEnoughData, RigError
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    geometric_parameters,
    loop_closure_parameter_jacobian,
    mechanism_with_parameters,
)
from rig.model.pose import exp, pose_difference
from tests.calib.noisy_samples import sampled
from tests.calib.random_hexapods import worst_jacobian
from tests.numerical_derivatives import jacobian


def test_loop_jacobian_agrees_with_differences(design):
    T = design.mechanism.home * exp(np.array([0.02, -0.03, 0.01, 0.1, -0.05, 0.2]))
    numeric = jacobian(
        lambda p: (
            -hexapod.inverse(T, mechanism_with_parameters(design.mechanism, geometric_parameters(design.mechanism) + p))
        ),
        np.zeros(42),
    )
    np.testing.assert_allclose(loop_closure_parameter_jacobian(T, design.mechanism), numeric, atol=1e-8)


def test_pose_jacobian_agrees_with_differences(design):
    lengths = hexapod.inverse(design.mechanism.home, design.mechanism) + np.array([0.01, -0.01, 0.02, 0, 0.005, -0.02])
    T = hexapod.forward(lengths, design.mechanism)
    start = geometric_parameters(design.mechanism)
    numeric = jacobian(
        lambda p: pose_difference(T, hexapod.forward(lengths, mechanism_with_parameters(design.mechanism, start + p))),
        np.zeros(42),
        1e-5,
    )
    np.testing.assert_allclose(pose_parameter_jacobian(T, design.mechanism), numeric, rtol=1e-5, atol=1e-5)


def test_pose_jacobian_over_random_machines_and_poses():
    assert worst_jacobian(60, seed=1) < 1e-7


def test_compiled_kinematics_are_the_mechanism_s(design):
    from calib.models.platform import strut_loop_closure_equations

    samples, true = sampled(design, 2, noisy=False)
    home = design.mechanism.home.as_matrix()
    R, t, e = home[:3, :3].copy(), home[:3, 3].copy(), np.empty(6)
    for command, T in zip(samples.commanded, samples.T_base_platform.as_matrix()):
        assert strut_loop_closure_equations.solve_pose_in_place_by_newton(command, geometric_parameters(true), R, t)
        strut_loop_closure_equations.fill_pose_error(
            R, t, np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]), e
        )
        np.testing.assert_allclose(e, 0, atol=1e-11)
    strut_loop_closure_equations.fill_pose_error(home[:3, :3], home[:3, 3], R, t, e)
    T = design.mechanism.home * exp(np.zeros(6))
    np.testing.assert_allclose(e, pose_difference(T, samples.T_base_platform[-1]), atol=1e-10)


def test_without_noise_the_machine_is_found(design):
    samples, true = sampled(design, 1, noisy=False)
    tight = replace(samples, covariance=samples.covariance * 1e-6, common=samples.common * 0)
    found = identify_platform(tight, design.mechanism)
    np.testing.assert_allclose(geometric_parameters(found.mechanism), geometric_parameters(true), atol=2e-8)


def test_parameters_scatter_as_claimed(design):
    z, chi2 = [], []
    for seed in range(40):
        samples, true = sampled(design, seed, count=60)
        found = identify_platform(samples, design.mechanism)
        error = geometric_parameters(found.mechanism) - geometric_parameters(true)
        z.append(error / np.sqrt(np.diag(found.covariance)))
        chi2.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(chi2) == pytest.approx(42, rel=0.1)
    assert np.std(z) == pytest.approx(1, abs=0.06) and np.abs(np.mean(z, axis=0)).max() < 4 / np.sqrt(40)


def test_strut_lengths_steady_the_shared_errors(design):
    """Taking the shared error for what it is, one draw, beats taking it for noise of every pose."""
    better = []
    for seed in range(10):
        samples, true = sampled(design, seed, count=200)
        pooled = replace(samples, covariance=samples.total_covariance(), common=samples.common[:, :, :0])
        errors = [
            np.linalg.norm(
                geometric_parameters(identify_platform(s, design.mechanism).mechanism) - geometric_parameters(true)
            )
            for s in (samples, pooled)
        ]
        better.append(errors[0] < 1.05 * errors[1])
    assert np.mean(better) > 0.5


def test_a_pose_that_is_wrong_is_left_out(design):
    samples, true = sampled(design, 3)
    T = samples.T_base_platform.as_matrix().copy()
    T[17, :3, 3] += [2e-3, 0, 1e-3]
    found = identify_platform(replace(samples, T_base_platform=RigidTransform.from_matrix(T)), design.mechanism)
    assert np.flatnonzero(~found.inliers).tolist() == [17]
    clean = identify_platform(samples.take(np.arange(120) != 17), design.mechanism)
    np.testing.assert_allclose(geometric_parameters(found.mechanism), geometric_parameters(clean.mechanism), atol=1e-7)


def test_scatter_of_one_strut_is_told_from_the_poses_noise(design):
    rng = np.random.default_rng(0)
    samples, _ = sampled(design, 4, deviation=lambda c: np.array([0, 0, 5e-5, 0, 0, 0]) * rng.normal(size=c.shape))
    found = identify_platform(samples, design.mechanism)
    assert np.flatnonzero(found.scatter).tolist() == [2] and found.scatter[2] == pytest.approx(5e-5, rel=0.25)
    assert not identify_platform(sampled(design, 4)[0], design.mechanism).scatter.any()


@pytest.mark.parametrize("count", [1, 2, 6])
def test_few_poses_move_what_they_tell_and_leave_the_rest(design, count):
    samples, true = sampled(design, 1)
    few = samples.take(np.arange(count))
    found = identify_platform(few, design.mechanism, prior=np.full(42, 3e-4))
    assert (np.linalg.svd(found.root * PRIOR, compute_uv=False) > 1).sum() == 6 * count and not found.scatter.any()
    stated, identified = (
        np.linalg.norm(geometric_parameters(true) - geometric_parameters(design.mechanism)),
        geometric_parameters(found.mechanism) - geometric_parameters(design.mechanism),
    )
    assert (
        np.linalg.norm(geometric_parameters(true) - geometric_parameters(found.mechanism)) < stated
        and np.linalg.norm(identified) < stated
    )
    left = found.residuals / np.sqrt(np.einsum("nii->ni", found.residual_covariance))
    assert np.abs(left).max() < 1


def test_poses_that_disagree_with_each_other_are_refused(design):
    samples, _ = sampled(design, 1, count=20)
    T = samples.T_base_platform.as_matrix()
    T[::2, 0, 3] += np.linspace(0.05, 0.15, 10)
    with pytest.raises((NotEnoughData, RigError)):
        identify_platform(replace(samples, T_base_platform=RigidTransform.from_matrix(T)), design.mechanism)


@pytest.mark.slow
def test_z_scores_of_five_hundred_runs(design):
    """Along every combination that the poses determine: no bias, and scatter as claimed."""
    along, z = None, []
    for seed in range(500):
        samples, true = sampled(design, seed, count=200)
        found = identify_platform(samples, design.mechanism)
        along = np.linalg.svd(found.root)[2] if along is None else along
        z.append(
            along
            @ (geometric_parameters(found.mechanism) - geometric_parameters(true))
            / np.sqrt(np.einsum("ki,ij,kj->k", along, found.covariance, along))
        )
    assert np.abs(np.mean(z, axis=0)).max() < 0.15 and np.std(z) == pytest.approx(1, abs=0.05)
