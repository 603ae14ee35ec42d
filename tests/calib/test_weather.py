"""Temperatures whose logs hold noise: smooth ones come back, others stay as they were logged."""

import numpy as np
import pytest

from calib.diagnose import result
from calib.diagnose.weather import smoothed
from rig.recording import Sensors
from synthetic.world import weather
from tests.calib.recorded import recorded


def test_a_smooth_temperature_loses_most_of_its_noise():
    errors = []
    for seed in range(20):
        true, log = weather(2400, np.random.default_rng(seed))
        kept = smoothed(log)
        errors += [[np.std(s.channels[name] - true.channels[name]) for s in (log, kept)] for name in true.channels]
    before, after = np.sqrt(np.mean(np.square(errors), axis=0))
    assert after < 0.45 * before and before == pytest.approx(0.03, rel=0.05)


@pytest.mark.parametrize("name", ["ambient_temperature_C", "payload_mass_kg"])
def test_what_is_not_smooth_stays(name):
    t = np.arange(100) * 30.0
    step = np.where(t > 1400, 3.0, 0.0) + 0.01 * np.random.default_rng(0).normal(size=100)  # a door opens, a load is put on
    for values in (step, np.round(np.linspace(0, 0.3, 100), 1), np.full(100, 20.0)):
        np.testing.assert_array_equal(smoothed(Sensors(t, {name: values})).channels[name], values)


def test_few_rows_and_no_log_stay():
    assert smoothed(None) is None
    few = Sensors(np.arange(5) * 30.0, {"ambient_temperature_C": np.array([20, 20.1, 20.05, 20.2, 20.1])})
    np.testing.assert_array_equal(smoothed(few).channels["ambient_temperature_C"], few.channels["ambient_temperature_C"])


def test_noise_of_a_thermometer_does_not_hide_a_strong_effect(tmp_path, design):
    rec = recorded(tmp_path, design, ["focal_drift:camera cam1:per_kelvin=4e-4"], route="sobol:100,ladder:2,sobol:100")
    found = result.diagnose(rec, only=["focal_drift", "camera_drift"])
    assert [(e.name, e.place) for e in found.effects] == [("focal_drift", "camera cam1")] and not found.unknown
