"""Claims from what was held out: intervals hold the truth where something is left out that no model has, and have a
width where nothing is fitted.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag, sqrtm

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, refutation_sentence
from calib.certification.claimed_error_reduction_over_workspace import (
    PLACES,
    ConfigurationInformation,
    claim_from_mean_square_errors,
)
from calib.certification.configuration_space_correction_certification import (
    ExtensionRequest,
    certify_extended_correction,
    claim_without_geometry,
)
from calib.certification.held_out_pose_error_statistics import (
    HeldErrors,
    mean_square_pose_errors_caused_by_parameters,
    residuals_corrected_for_absorbed_noise,
)
from calib.correction.machine_correction import Correction, solvable_commands_and_poses
from calib.models.additional_correction_pass import CorrectionPass, certify_additional_pass
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import certify_arm as certify_arm
from calib.models.arm.joint_space_correction_and_workspace_claim import arm_workspace_claim as promised_arm
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import sobol_configurations
from tests.calib import secret_arms as worlds
from tests.calib.noisy_samples import real, rms, sampled
from tests.rig.arms import UR10


def playing(gap, seed):
    """Struts that stand at either end of a gap (m), whichever they came to last."""
    rng = np.random.default_rng(seed + 7)
    return lambda commands: gap / 2 * rng.choice([-1.0, 1.0], commands.shape)


def test_draws_of_a_mean_square_hold_it_whether_few_or_many_tell_it():
    rng = np.random.default_rng(0)
    for count in (8, 40):
        inside = 0
        for _ in range(200):
            squares = ((rng.normal(size=(count, 3)) ** 2).sum(axis=1) * rng.chisquare(4, count) / 4)[:, None] * [
                1.0,
                1.0,
            ]  # of unlike places
            low, high = np.quantile(HeldErrors(squares, np.zeros((count, 2))).draws(400, rng)[:, 0], [0.025, 0.975])
            inside += low < 3.0 < high
        assert inside >= 184


def test_noise_that_explains_all_leaves_nothing_and_what_was_not_measured_is_nothing():
    squares = np.column_stack([np.full(20, 3.0), np.full(20, np.nan)])
    held = HeldErrors(squares, np.column_stack([np.full(20, 3.0), np.full(20, np.nan)]))
    draws = held.draws(1000, np.random.default_rng(0))
    assert held.beyond().tolist() == [0.0, 0.0] and (draws[:, 1] == 0).all() and np.quantile(draws[:, 0], 0.975) < 3.0


@pytest.mark.parametrize("owners", [0.0, 1e-9])
def test_a_factor_is_finite_where_noise_explains_all_that_is_left(design, owners):
    samples, _ = sampled(design, 0, 10, None)
    claim = claim_from_mean_square_errors(
        np.full((100, 2), owners),
        np.zeros((100, 2)),
        "here",
        samples,
        ConfigurationInformation(10, 0, 0, 0, ""),
        np.random.default_rng(0),
    )
    assert np.isfinite([claim.ratio, claim.measured]).all() and claim.after[0] == (0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="ratio of a claim"):
        replace(claim, ratio=(1.0, np.nan, np.nan))


@pytest.mark.parametrize("method", ["alone", "onto"])
def test_a_claim_of_a_field_or_of_a_pass_holds_what_play_leaves(design, method):
    m, inside, wide = design.mechanism, 0, []
    for seed in range(8):
        play, rng = playing(56e-6, seed), np.random.default_rng(seed)
        samples, true = sampled(design, seed, 40, play)
        if method == "alone":
            done, _ = certify_extended_correction(samples, m, ExtensionRequest("radial", True), rng)
        else:
            before = Calibration(Correction(m, true, (None,) * 6), np.zeros((42, 42)), np.zeros(6), (), (), None, {})
            done, _, _ = certify_additional_pass(samples, before, CorrectionPass("radial"), rng)
        _, low, high = claim_without_geometry(samples, done, rng).after[0]
        commands, T = solvable_commands_and_poses(sobol_configurations(m.strut_range, 200, 0.8, 77), done.correction)
        inside += low <= rms(pose_difference(T, real(commands, true, play)))[0] <= high
        wide.append(high / low)
    assert inside >= 7 and 1.2 < min(wide) < max(wide) < 4


@pytest.mark.slow
def test_an_arm_whose_noise_is_stated_ten_times_too_small_says_so_and_claims_what_is_left():
    rng = np.random.default_rng(4)
    true = worlds.secret(UR10, rng)
    sigma = np.repeat([2e-5, 1e-4], 3)
    samples = worlds.tracked(true, UR10, 60, rng, tuple(10 * sigma[[0, 3]]))
    small = worlds.replace(samples, covariance=samples.covariance / 100)
    done = certify_arm(small, UR10, worlds.TRACKER, rng)
    claim = promised_arm(small, done, rng)
    assert any(
        "positions of the hand scatter by 0.3" in line and "beyond the 0.0346 mm stated for them" in line
        for line in claim.unexplained
    )
    honest = certify_arm(samples, UR10, worlds.TRACKER, np.random.default_rng(4))
    assert promised_arm(samples, honest, np.random.default_rng(4)).unexplained == ()


@pytest.mark.slow
@pytest.mark.parametrize("gears", [0.0, 4e-4])
def test_an_arms_claim_is_never_better_than_poses_held_out_allow(gears):
    inside = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        true = worlds.secret(UR10, rng)

        def deviation(q, true=true):
            return gears * np.sin(9 * q + np.arange(6))

        samples = worlds.tracked(true, UR10, 60, rng, deviation=deviation)
        done = certify_arm(samples, UR10, worlds.TRACKER, rng)
        claim = promised_arm(samples, done, rng)
        seen = np.stack([samples.commanded.min(axis=0), samples.commanded.max(axis=0)], axis=1)
        q = sobol_configurations(seen, PLACES, 0.8)
        off = pose_difference(
            done.correction.predict(q),
            arm_error_model_and_instrument_observations.predicted_target_poses(q + deviation(q), true),
        )
        inside += claim.after[0][1] <= rms(off)[0] <= claim.after[0][2]
    assert inside >= 5


def test_shares_that_samples_tell_themselves_agree_with_every_direction_of_their_poses():
    """Fewer directions than numbers of a part: the others are what the fit does not touch. One parameter is fixed."""
    n, p, rng = 40, 9, np.random.default_rng(3)
    J, residuals, part = rng.normal(size=(n, 6, p)), rng.normal(size=(n, 6)), np.arange(n) % 3
    J[..., :3] *= 1e-4  # of other units
    noise = np.eye(6) + np.einsum("nij,nkj->nik", *[rng.normal(size=(n, 6, 6))] * 2)
    seen = np.linalg.solve(np.linalg.cholesky(noise), J)
    covariance = np.linalg.inv(np.einsum("nij,nik->jk", seen, seen) + np.diag([1e30] + [0.0] * (p - 1)))
    freed = residuals_corrected_for_absorbed_noise(residuals, J, covariance, noise, part)
    squares = mean_square_pose_errors_caused_by_parameters(J, covariance, noise, part)
    wanted = np.zeros((2, n, 6))
    for own in (part == k for k in range(3)):
        L = block_diag(*np.linalg.cholesky(noise[own]))
        hat = seen[own].reshape(-1, p) @ covariance @ seen[own].reshape(-1, p).T
        rest = np.linalg.inv(np.eye(len(hat)) - hat)
        wanted[0, own] = (L @ sqrtm(rest).real @ np.linalg.solve(L, residuals[own].ravel())).reshape(-1, 6)
        wanted[1, own] = np.diag(L @ hat @ rest @ L.T).reshape(-1, 6)
    np.testing.assert_allclose(freed, wanted[0], rtol=1e-9)
    np.testing.assert_allclose(squares, wanted[1].mean(axis=0).reshape(2, 3).sum(axis=1), rtol=1e-9)


def test_a_claim_missed_by_far_is_read_without_powers_of_ten():
    part = SimpleNamespace(kept=False, rms=1.0193e-3, claimed=27.1e-6)
    words = refutation_sentence(SimpleNamespace(parts={"position": part}))
    assert words == "position error 1020 um RMS where up to 27.1 um is claimed"
