"""Limits without a distribution: hand-worked ranks, kept as often as promised, with noise and without."""

import numpy as np
import pytest
from scipy.stats import binom

from calib.certification import noise_free_errors_and_tolerance_limits
from rig.errors import NotEnoughData


def test_the_smallest_samples_are_those_of_the_tables():
    levels = ((0.95, 0.95), (0.9, 0.95), (0.99, 0.95), (0.95, 0.975), (0.5, 0.5))
    assert [noise_free_errors_and_tolerance_limits.least_sample_size(*level) for level in levels] == [
        59,
        29,
        299,
        72,
        1,
    ]


def test_fewer_say_what_they_can():
    with pytest.raises(
        NotEnoughData,
        match=r"^41 distinct .* requires 59 with 95% .* 93.0% of poses with 95.0% .* 95% with 87.8%.* record 18 more",
    ):
        noise_free_errors_and_tolerance_limits.upper_tolerance_limit(np.arange(41.0))
    assert noise_free_errors_and_tolerance_limits.upper_tolerance_limit(
        np.arange(41.0), 0.95, 0.87
    ) <= 40 and noise_free_errors_and_tolerance_limits.upper_tolerance_limit(np.arange(59.0)) == pytest.approx(
        58, abs=0.1
    )


@pytest.mark.parametrize("n, rank", [(93, 92), (124, 122), (208, 203), (548, 530)])
def test_ranks_are_those_of_wilks(n, rank):
    """Greatest k beyond the limit with P(Bin(n, 0.05) <= k) <= 0.05, and the limit lies between that rank and the one
    before.
    """
    k = n - rank
    assert binom.cdf(k, n, 0.05) <= 0.05 < binom.cdf(k + 1, n, 0.05)
    assert (
        rank - 1 - 1e-9
        <= noise_free_errors_and_tolerance_limits.upper_tolerance_limit(np.arange(1.0, n + 1))
        <= rank + 1e-9
    )


@pytest.mark.parametrize("n", [59, 100, 240])
def test_limits_are_kept_as_often_as_promised_whatever_the_distribution(n):
    """The share below a value is all that matters, so uniform values stand for every distribution."""
    values = np.random.default_rng(n).random((1500, n))
    upper = np.mean([noise_free_errors_and_tolerance_limits.upper_tolerance_limit(row) >= 0.95 for row in values])
    lower = np.mean(
        [noise_free_errors_and_tolerance_limits.lower_confidence_limit_of_quantile(row) <= 0.95 for row in values]
    )
    assert 0.935 <= upper <= 0.97 and (0.935 <= lower <= 0.97 or n == 59 and lower >= 0.935)


def test_without_noise_true_errors_are_those_measured():
    lengths = np.random.default_rng(1).exponential(1e-5, 120)
    found = noise_free_errors_and_tolerance_limits.tolerance_limits_of_true_errors(lengths, np.full(120, 1e-9))
    assert found.upper == noise_free_errors_and_tolerance_limits.upper_tolerance_limit(
        lengths
    ) and found.lower == noise_free_errors_and_tolerance_limits.lower_confidence_limit_of_quantile(lengths)


def _trials(n, noise, count, seed):
    """(share kept, mean limit over truth, mean limit of the errors as measured over truth): true errors of two kinds,
    one wide.
    """
    rng = np.random.default_rng(seed)
    wide = rng.choice([1.0, 3.0], size=(count + 1, n, 1), p=[0.8, 0.2])
    truth = np.linalg.norm(
        rng.normal(size=(300_000, 3)) * rng.choice([1.0, 3.0], size=(300_000, 1), p=[0.8, 0.2]), axis=1
    )
    goal = np.quantile(truth, 0.95)
    measured = [
        np.linalg.norm(rng.normal(size=(n, 3)) * w + noise * rng.normal(size=(n, 3)), axis=1) for w in wide[:count]
    ]
    limits = np.array(
        [
            noise_free_errors_and_tolerance_limits.tolerance_limits_of_true_errors(lengths, np.full(n, noise)).upper
            for lengths in measured
        ]
    )
    plain = np.array([noise_free_errors_and_tolerance_limits.upper_tolerance_limit(lengths) for lengths in measured])
    return np.mean(limits >= goal), limits.mean() / goal, plain.mean() / goal


@pytest.mark.slow
def test_noise_is_taken_off_and_the_promise_still_kept():
    share, size, plain = _trials(120, 0.5, 4, 2)
    assert share >= 0.75 and size <= plain


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.5, 1.0, 3.0])
def test_noise_is_taken_off_and_the_promise_kept_many_times(noise):
    share, size, plain = _trials(150, noise, 200, 3)
    assert share >= 0.93 and size < 1.05 * plain


def test_errors_smaller_than_their_stated_noise_promise_no_nothing():
    """Who states too much noise is not rewarded: what is taken off is never more than there is."""
    lengths = np.linalg.norm(np.random.default_rng(4).normal(size=(100, 3)), axis=1)
    stated, twice = (
        noise_free_errors_and_tolerance_limits.tolerance_limits_of_true_errors(lengths, np.full(100, sigma)).upper
        for sigma in (1.0, 2.0)
    )
    assert twice == pytest.approx(stated, rel=0.1) and twice > 0


@pytest.mark.parametrize("level", [(0.95, 0.95), (0.9, 0.9)])
@pytest.mark.parametrize("n", [59, 75, 93, 120])
def test_between_ranks_the_confidence_is_met_in_tails_light_and_heavy(n, level):
    rng = np.random.default_rng(n)
    for draw, quantile in ((rng.random, level[0]), (rng.standard_exponential, -np.log(1 - level[0]))):
        values = draw((4000, n))
        found = np.mean(
            [noise_free_errors_and_tolerance_limits.upper_tolerance_limit(row, *level) >= quantile for row in values]
        )
        assert found == pytest.approx(level[1], abs=0.015)


def test_at_whole_ranks_nothing_is_interpolated():
    chance = binom.sf(140 - 1, 150, 0.95)  # that the 140th of 150 lies below the quantile
    assert noise_free_errors_and_tolerance_limits.rank_below_quantile(150, 0.95, chance) == pytest.approx(140, abs=1e-6)
