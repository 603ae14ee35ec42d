"""Which frequencies a vibration can be told at: every one of its own, none that mirrors a drift."""

from dataclasses import replace

import numpy as np
import pytest

import calib
import rig
from calib.diagnosis.problems.platform.platform_vibration_frequency_search import (
    COMB,
    _bins,
    _mirrors_of_slow_changes,
    power_spectrum_at_sparse_times,
)
from tests.truth import draw, record
from tests.truth.case import Case
from tests.truth.draw_faults import FAULTS, FaultRequest
from tests.truth.laws import stood
from tests.truth.rigid import displaced, rows_of

HIGH = 50.0  # Hz


def spectrum(t, x):
    """Power of x (n,) at times t (n,) s on the bins that are searched."""
    length = np.ptp(t) + 1e-9
    bins, step = _bins(length, HIGH)
    return np.abs(np.fft.rfft(np.bincount(np.rint((t - t[0]) / step).astype(int), x, bins)[:bins], bins)) ** 2, length


def mirrored(t, x):
    """(bins,) whether each frequency of x (n,) at times t (n,) s may mirror a slow change."""
    power, length = spectrum(t, x)
    window = np.sqrt(spectrum(t, np.ones(len(t)))[0]) / len(t)
    return _mirrors_of_slow_changes(power, window, length, HIGH)


def at(frequency, t):
    """Number of a frequency's bin at times t (n,) s."""
    length = np.ptp(t) + 1e-9
    bins, step = _bins(length, HIGH)
    return int(round(frequency * bins * step))


@pytest.mark.parametrize("transforms", [1, 2, 3, 8])
def test_many_short_transforms_are_one_long_one(transforms):
    rng, bins = np.random.default_rng(4), transforms * COMB
    at, series = np.sort(rng.integers(0, bins // 4, 90)), rng.normal(size=(3, 90))
    whole = sum(np.abs(np.fft.rfft(np.bincount(at, one, bins))) ** 2 for one in series)
    np.testing.assert_allclose(power_spectrum_at_sparse_times(series, at, bins), whole, atol=1e-4 * np.max(whole))


def test_a_drift_at_even_times_is_mirrored_about_their_rate():
    t = np.arange(200) * 4.0
    assert mirrored(t, np.sin(2 * np.pi * 0.002 * t))[at(10.0 + 0.002, t)]


def test_a_vibration_at_uneven_times_is_its_own_even_where_they_mirror_a_little():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(3, 8, 100))
    window, length = spectrum(t, np.ones(100))
    frequency = float(np.argmax(window[at(5.0, t) :]) + at(5.0, t)) / (_bins(length, HIGH)[0] * _bins(length, HIGH)[1])
    shaken = np.sin(2 * np.pi * frequency * t) + 0.3 * rng.normal(size=100)
    assert not mirrored(t, shaken)[at(frequency, t)]
    drift = np.cos(2 * np.pi * 0.5 / length * t)
    assert mirrored(t, drift)[at(frequency, t)]


def shaken_case(seed: int) -> Case:
    """A hexapod that shakes at two frequencies, by a law of the independent truth."""
    rng = np.random.default_rng([5, seed])
    case = draw(5000 + seed, "vibration", "weak", "shuffled", "hexapod", count=120)
    size = 16 * case.sigma[0]
    request = FaultRequest(
        size, np.eye(6)[0], case.machine, case.journey, 5.0, case.mass, case.centre, case.payload, rng
    )
    case = replace(case, laws=(FAULTS["vibration"](request)[1],))
    noise = rng.normal(size=(len(case.journey.looked), 6)) * np.repeat(case.sigma, 3)
    return replace(case, seen=rows_of(displaced(stood(case.machine, case.journey, case.day, case.laws), noise)))


@pytest.mark.slow
@pytest.mark.parametrize(  # at times that mirror a drift a little there; beyond 50 Hz
    "seed", [2, 3]
)
def test_two_frequencies_are_two_findings_and_nothing_else(tmp_path, seed):
    case = shaken_case(seed)
    findings = calib.diagnose(rig.load(record(case, tmp_path / "a"))).report.findings
    assert [(one.effect, one.place) for one in findings] == [("vibration", "rig")] * 2
    found = sorted(one.parameters["frequency"].value for one in findings)
    np.testing.assert_allclose(found, np.sort(case.laws[0].rates), atol=1e-4)
