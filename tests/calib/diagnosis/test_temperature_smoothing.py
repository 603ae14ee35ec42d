"""Temperatures whose logs hold noise: smooth ones come back, others stay as they were logged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.api.diagnose import diagnose
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    smoothed_temperatures_and_errors,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.tolerance_and_temperature_alternatives import (
    parameter_errors_by_temperature_logs,
)
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.cli import command_line
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.recording.recording_folder import Sensors, load_recording
from synthetic.random_true_machine_and_truth_file import random_true_and_logged_temperatures
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded

FAR = 2.0  # standard deviations: what is farther off, the scatter of its strut takes up instead


def test_a_smooth_temperature_loses_most_of_its_noise():
    errors = []
    for seed in range(20):
        true, log = random_true_and_logged_temperatures(2400, np.random.default_rng(seed))
        smoothed, _ = smoothed_temperatures_and_errors(log)
        errors += [[np.std(s.channels[name] - true.channels[name]) for s in (log, smoothed)] for name in true.channels]
    before, after = np.sqrt(np.mean(np.square(errors), axis=0))
    assert after < 0.45 * before and before == pytest.approx(0.03, rel=0.05)


@pytest.mark.parametrize("seconds", [180, 330])
def test_a_short_log_is_a_line_rather_than_its_noise(seconds):
    errors, stated = [], []
    for seed in range(40):
        true, log = random_true_and_logged_temperatures(seconds, np.random.default_rng(seed))
        smoothed, off = smoothed_temperatures_and_errors(log)
        for name in off:
            errors.append([np.mean((s.channels[name] - true.channels[name]) ** 2) for s in (log, smoothed)])
            stated.append(np.mean(np.sum(off[name] ** 2, axis=1)))
    before, after = np.sqrt(np.mean(errors, axis=0))
    assert len(errors) > 0.9 * 40 * 7 and after < 0.6 * before
    assert np.mean(stated) > 0.5 * after**2


@pytest.mark.parametrize("name", ["ambient_temperature_C", "payload_mass_kg"])
def test_what_is_not_smooth_stays(name):
    t = np.arange(100) * 30.0
    step = np.where(t > 1400, 3.0, 0.0) + 0.01 * np.random.default_rng(0).normal(
        size=100
    )  # a door opens, a load is put on
    for values in (step, np.round(np.linspace(0, 0.3, 100), 1), np.full(100, 20.0)):
        np.testing.assert_array_equal(
            smoothed_temperatures_and_errors(Sensors(t, {name: values}))[0].channels[name], values
        )


def test_few_rows_and_no_log_stay():
    assert smoothed_temperatures_and_errors(None) == (None, {})
    few = Sensors(np.arange(5) * 30.0, {"ambient_temperature_C": np.array([20, 20.1, 20.05, 20.2, 20.1])})
    np.testing.assert_array_equal(
        smoothed_temperatures_and_errors(few)[0].channels["ambient_temperature_C"],
        few.channels["ambient_temperature_C"],
    )


@pytest.mark.slow
def test_noise_of_a_thermometer_does_not_hide_a_strong_effect(tmp_path, design):
    rec = recorded(tmp_path, design, ["focal_drift:camera cam1:per_kelvin=4e-4"], route="sobol:100,ladder:2,sobol:100")
    found = diagnosis_of(rec, only=["focal_drift", "camera_drift"])
    assert [(e.name, e.place) for e in found.effects] == [("focal_drift", "camera cam1")] and not found.left


@pytest.mark.slow
def test_intervals_hold_what_the_thermometer_leaves_open(tmp_path, design):
    rec = recorded(
        tmp_path,
        design,
        ["thermal_expansion:strut2:coefficient=6e-5", "focal_drift:camera cam1:per_kelvin=2e-4"],
        route="sobol:60,ladder:2,sobol:60",
    )
    k = operating_point_source_and_measurement(rec)[0].with_effects(
        [
            parse_effect("thermal_expansion:strut2:coefficient=6e-5"),
            parse_effect("focal_drift:camera cam1:per_kelvin=2e-4"),
        ]
    )
    sensitivities = Sensitivities(k)
    refined = refine_operating_point(k, sensitivities)
    more = (parameter_errors_by_temperature_logs(refined) ** 2).sum(axis=1)
    seen = np.zeros(2)
    for channel in ("strut2_temperature_C", "ambient_temperature_C"):
        for error in k.log_errors[channel].T:
            ends = []
            for size in (-FAR, FAR):  # a fit stops within a part of a standard deviation
                course = {**k.sensors.channels, channel: k.sensors.channels[channel] + size * error}
                ends.append(
                    refine_operating_point(
                        replace(refined.point, sensors=replace(k.sensors, channels=course)), sensitivities
                    ).values
                )
            seen += ((ends[1] - ends[0]) / (2 * FAR)) ** 2
    np.testing.assert_allclose(more, seen, rtol=0.1)
    assert (more > 0.01 * np.diag(refined.covariance)).all()


def test_a_machine_without_a_base_plate_has_none_that_grows(tmp_path):
    delta = Path(__file__).parents[3] / "docs" / "kinematics" / "delta.toml"
    effects = ("--effect", "scale_error:slide2:scale=2e-3", "--truth", str(tmp_path / "truth.json"))
    plan = ("--plan", "sobol:60", "--seed", "3")
    command_line.main(["simulate", str(delta), *plan, *effects, "--out", str(tmp_path / "rec")])
    (tmp_path / "rec" / "sensors.csv").unlink()  # whose temperatures nobody logged
    findings = diagnosis_report(diagnose(load_recording(tmp_path / "rec")).found).findings
    assert [(f.effect, f.place) for f in findings] == [("scale_error", "slide 2")]
    assert "base_expansion" not in {a.effect for f in findings for a in f.cannot_be_told_from}
