"""What a calibration claims, held against what its machine does elsewhere; how little a few configurations can
claim.
"""

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import claim_lines, verification_line
from calib.certification.claim_verification import verify_claim
from calib.certification.held_out_pose_error_statistics import compare_errors, errors_before_and_after_correction
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    axis_travel_limits,
    configuration_numbers,
    mean_sample_per_configuration,
    time_block_folds_of_configurations,
)
from calib.certification.platform_certification import certify_platform, platform_workspace_claim
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    estimate_tolerance_of_stated_geometry,
)
from calib.models.platform.platform_identification import identify_platform
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.model.pose import pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.noisy_samples import sampled


def visited(mechanism, distinct, repeats, seed):
    """(distinct + repeats, 6) m commands, in any order, some of them again."""
    rng = np.random.default_rng(seed)
    commands = configuration_generators.sobol_configurations(mechanism.strut_range, max(distinct, 2), seed=seed)[
        :distinct
    ]
    return commands[rng.permutation(np.r_[np.arange(distinct), rng.integers(distinct, size=repeats)])]


def elsewhere(correction, true, seed):
    """before / after of the true machine, driven to 300 other configurations of the same workspace."""
    nominal = correction.nominal
    commands = configuration_generators.sobol_configurations(nominal.strut_range, 300, seed=7000 + seed)
    real = hexapod.forward(commands, true)
    before, after = (
        np.mean(pose_difference(model, real)[:, :3] ** 2)
        for model in (hexapod.forward(commands, nominal), correction.predict(commands))
    )
    return np.sqrt(before / after)


def at_poses(design, seed, distinct, repeats):
    """(Claim, before / after elsewhere) of a recording simulated pose by pose."""
    commands = visited(design.mechanism, distinct, repeats, seed)
    samples, true = sampled(design, seed, len(commands), commands=commands)
    return concluded(design, samples, true, seed)


def at_corners(design, text, folder, seed, distinct, repeats):
    """(Claim, before / after elsewhere) of a recording simulated corner by corner, measured by its cameras."""
    rng, strokes = np.random.default_rng(seed), design.mechanism.strut_range
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng)
    route = plan.plan_of_configurations(
        visited(design.mechanism, distinct, repeats, seed), strokes.mean(axis=1), plan.planned_axis_speeds(design)
    )
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, route, rng), folder, text, rng, 0.04
    )
    return concluded(
        design, sample_recording(recording_folder.load_recording(folder)).samples, secret.true.mechanism, seed
    )


def concluded(design, samples, true, seed):
    done = certify_platform(samples, design.mechanism, np.random.default_rng(seed))
    return platform_workspace_claim(samples, done, np.random.default_rng(seed)), elsewhere(done.correction, true, seed)


def test_repeats_are_one_configuration_from_whichever_side(design):
    strokes = design.mechanism.strut_range
    ladder = plan.build_plan(design, "ladder:4")
    commands = np.stack([np.interp(ladder.t, ladder.commands.t, column) for column in ladder.commands.values.T], axis=1)
    label = configuration_numbers(commands, strokes)
    middle = np.abs(commands - strokes.mean(axis=1)).max(axis=1) < 1e-6
    assert middle.sum() == 48 and len(set(label[middle])) == 1 and label.max() + 1 == 49
    fold = time_block_folds_of_configurations(label, 5)
    assert set(fold) == set(range(5)) and all(len(set(fold[label == k])) == 1 for k in set(label))


def test_witnesses_say_what_all_poses_say(design):
    commands = visited(design.mechanism, 12, 40, 3)
    samples, _ = sampled(
        design, 3, len(commands), commands=commands + 2e-6 * np.random.default_rng(0).normal(size=commands.shape)
    )
    label = configuration_numbers(samples.commanded, axis_travel_limits(design.mechanism))
    to_pose = np.linalg.inv(hexapod.jacobian(samples.T_base_platform, design.mechanism))
    each = mean_sample_per_configuration(samples, label, to_pose)
    together, apart = (identify_platform(some, design.mechanism) for some in (each, samples))
    assert len(each) == 12 and np.bincount(label).max() > 1
    assert (
        np.abs(geometric_parameters(together.mechanism) - geometric_parameters(apart.mechanism)).max()
        < 0.05 * np.sqrt(np.diag(apart.covariance)).min()
    )
    np.testing.assert_allclose(
        together.root.T @ together.root, apart.root.T @ apart.root, rtol=1e-2, atol=1e-3 * np.abs(apart.root).max() ** 2
    )
    np.testing.assert_allclose(together.covariance, apart.covariance, rtol=2e-2, atol=1e-2 * apart.covariance.max())


def test_the_owners_tolerance_is_read_off_the_poses(design):
    samples, true = sampled(design, 4, count=40)
    known = estimate_tolerance_of_stated_geometry(identify_platform(samples, design.mechanism), design.mechanism)
    off = geometric_parameters(true) - geometric_parameters(design.mechanism)
    assert known.prior[0] == pytest.approx(np.sqrt(np.mean(off[:36] ** 2)), rel=0.3)
    assert known.prior[-1] == pytest.approx(
        np.sqrt(np.mean(off[36:] ** 2)), rel=0.8
    ) and known.weight.sum() == pytest.approx(1)


@pytest.mark.parametrize("distinct", [1, 4, 6, 7])
def test_few_configurations_claim_no_factor_and_say_why(design, distinct):
    commands = visited(design.mechanism, distinct, 30 - distinct, 2)
    samples, _ = sampled(design, 2, 30, commands=commands)
    done = certify_platform(samples, design.mechanism, np.random.default_rng(0))
    claim = platform_workspace_claim(samples, done, np.random.default_rng(0))
    assert (
        done.held_out is None
        and claim.ratio is None
        and claim.distinct == distinct
        and claim.determined == min(6 * distinct, 42)
    )
    lines = claim_lines(claim)
    assert (
        lines[0].startswith("no factor is claimed")
        and "takes 8" in lines[0]
        and f"{min(6 * distinct, 42)} of 42 combinations" in lines[1]
    )


def test_a_claim_is_kept_or_it_is_not(design):
    samples, true = sampled(design, 6, 30)
    done = certify_platform(samples, design.mechanism, np.random.default_rng(0))
    claim = platform_workspace_claim(samples, done, np.random.default_rng(0))
    commands = configuration_generators.sobol_configurations(design.mechanism.strut_range, 40, seed=77)
    fresh = sampled(design, 6, 40, commands=commands, noise_seed=5)[0]
    other = sampled(
        design,
        6,
        40,
        commands=commands,
        noise_seed=5,
        deviation=lambda c: np.full(c.shape, 2e-4) * [1, -1, 1, -1, 1, -1],
    )[0]
    held = [
        compare_errors(
            *errors_before_and_after_correction(done.correction, some),
            some.total_covariance(),
            np.random.default_rng(0),
        )
        for some in (fresh, other)
    ]
    found = [
        verify_claim(done.correction.predict(some.effective), some, np.arange(40), claim, np.random.default_rng(0))
        for some in (fresh, other)
    ]
    assert [one.kept for one in found] == [True, False]
    assert "the claim is kept" in verification_line(held[0], claim, found[0]) and "NOT kept" in verification_line(
        held[1], claim, found[1]
    )


@pytest.mark.slow
def test_repeats_make_no_claim_better_than_its_configurations(design):
    claims = [at_poses(design, 5, 10, repeats)[0] for repeats in (0, 150)]
    assert claims[1].distinct == 10 and claims[1].ratio[0] < 1.6 * claims[0].ratio[0]
    assert at_poses(design, 5, 60, 0)[0].after[0][0] < claims[1].after[0][0]


@pytest.mark.slow
def test_claims_cover_what_is_found_elsewhere(design):
    rng, inside = np.random.default_rng(0), []
    for seed in range(20):
        claim, found = at_poses(design, seed, int(rng.integers(8, 61)), int(rng.integers(0, 40)))
        inside.append(claim.ratio[1] <= found <= claim.ratio[2])
    assert np.mean(inside) >= 0.8  # 0.95 of 20: fewer than 16 once in 400 000


@pytest.mark.slow
def test_two_hundred_recordings_claim_what_they_keep(design, rig_text, tmp_path):
    """2 to 60 distinct configurations with repeats, corners as cameras see them: the claim's interval holds what is
    found elsewhere.
    """
    rng, inside, apart = np.random.default_rng(1), [], []
    for seed in range(200):
        distinct, repeats = int(rng.integers(2, 61)), int(rng.integers(0, 31))
        claim, found = at_corners(design, rig_text, tmp_path / str(seed), seed, distinct, repeats)
        if distinct < 8:
            assert claim.ratio is None and claim.reason
            continue
        inside.append(claim.ratio[1] <= found <= claim.ratio[2])
        apart.append(np.log(claim.ratio[0] / found))
    print(
        f"{np.sum(inside)} of {len(inside)} inside; claim over found, median {np.exp(np.median(apart)):.3f}, "
        f"spread {np.exp(np.std(apart)):.2f}"
    )
    assert np.mean(inside) >= 0.9 and abs(np.median(apart)) < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("count", range(1, 16))
def test_every_small_recording_is_calibrated(design, rig_text, tmp_path, count):
    claim, found = at_corners(design, rig_text, tmp_path / "rec", 100 + count, count, 0)
    assert claim.distinct == count and (claim.ratio is None) == (count < 8)
    assert found > 1.2  # whatever the few poses tell helps elsewhere
