"""What is promised from held-out poses."""

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import verification_line
from calib.certification.held_out_pose_error_statistics import compare_errors, error_statistics
from calib.certification.platform_certification import certify_platform
from calib.identify.bounded_and_robust_least_squares_fit import time_block_folds
from tests.calib.noisy_samples import sampled


def test_figures_are_hand_worked():
    errors = np.zeros((4, 6))
    errors[:, 0], errors[:, 4] = [3e-3, 0, 0, 0], [0, 0, 0, 4e-3]
    found = error_statistics(errors)
    assert (
        found.position == pytest.approx((1.5e-3, 3e-3 * 0.85, 3e-3))
        and found.rotation[0] == pytest.approx(2e-3)
        and found.n == 4
    )
    assert found.bias == pytest.approx((7.5e-4, 0, 0, 0, 1e-3, 0))


def test_ratio_comes_with_an_interval():
    rng = np.random.default_rng(0)
    before, after = 1e-3 * rng.normal(size=(200, 6)), 1e-5 * rng.normal(size=(200, 6))
    held = compare_errors(before, after, np.tile(np.eye(6) * 1e-10, (200, 1, 1)), rng)
    assert held.ratio[1] < held.ratio[0] < held.ratio[2] and held.ratio[0] == pytest.approx(100, rel=0.1)
    assert held.floor == pytest.approx((np.sqrt(3) * 1e-5, np.sqrt(3) * 1e-5))


@pytest.mark.parametrize(("count", "where"), [(1, "this 1 configuration:"), (7, "these 7 configurations:")])
def test_few_configurations_have_no_interval(count, where):
    """Drawn anew from themselves they always say the same."""
    rng = np.random.default_rng(0)
    held = compare_errors(
        1e-3 * rng.normal(size=(40, 6)),
        1e-5 * rng.normal(size=(40, 6)),
        np.tile(np.eye(6) * 1e-10, (40, 1, 1)),
        rng,
        np.arange(40) % count,
    )
    assert np.isnan(held.ratio[1:]).all() and held.configurations == count
    line = verification_line(held, None, None)
    assert f"(too few configurations for an interval) on {where}" in line and "nan" not in line


@pytest.mark.slow
def test_held_out_poses_are_as_good_as_they_are_measured(design):
    samples, _ = sampled(design, 1, count=200)
    held = certify_platform(samples, design.mechanism, np.random.default_rng(0)).held_out
    assert held.ratio[0] > 50
    assert held.after.position[0] < 1.3 * held.floor[0]


def test_a_remainder_that_does_not_pay_is_dropped(design):
    """A drift in time looks like a function of the configuration to the samples it was fitted on, and to no others."""
    samples, _ = sampled(
        design, 2, count=100, deviation=lambda c: np.linspace(0, 4e-5, len(c))[:, None] * np.array([0, 1.0, 0, 0, 0, 0])
    )
    done = certify_platform(samples, design.mechanism, np.random.default_rng(0))
    assert done.correction.remainder == (None,) * 6 and done.held_out.after.n == 100


@pytest.mark.slow
def test_a_remainder_that_pays_is_kept(design):
    def bowed(c):
        out = np.zeros(c.shape)
        out[:, 3] = 8e-5 * np.sin((c[:, 3] - 0.47) / 0.015)
        return out

    done = certify_platform(
        sampled(design, 3, count=250, deviation=bowed)[0], design.mechanism, np.random.default_rng(0)
    )
    held = done.held_out
    assert [part is not None for part in done.correction.remainder] == [False, False, False, True, False, False]
    assert held.after.position[0] < 1.5 * held.floor[0]


def test_blocks_are_whole_stretches():
    fold = time_block_folds(23, 5)
    assert (np.diff(fold) >= 0).all() and set(fold) == {0, 1, 2, 3, 4} and np.bincount(fold).min() >= 4
