"""How sure a size is: intervals hold what printed markers leave open, and end where what makes sense does, which is
said.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Z95
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Value, value_with_interval_cut_at_bounds
from calib.diagnosis.problems.platform import marker_and_thermometer_tolerance_model_and_significance
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    Refinement,
    refine_at_fixed_repeated_corner_error,
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.marker_and_thermometer_tolerance_model_and_significance import (
    tolerance_sigmas_from_residuals,
)
from calib.diagnosis.problems.platform.tolerance_and_temperature_alternatives import (
    parameter_errors_per_tolerance_deviation,
    widen_intervals_by_temperature_logs_and_tolerances,
)
from calib.diagnosis.report import diagnosis_sentences_and_table_rows
from calib.diagnosis.report.diagnosis_json_entries import FindingEntry
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model.arm_hands_effect_places_and_tolerances import SIDES
from synthetic import random_blind_platform_cases_with_truth
from tests.calib.recordings_with_effects import recorded

ROUTE, SCALE, SIDE = "sobol:24", "print_scale:markers:scale=2e-3", 1e-4
FAR = 1e-3  # of its side that a marker is larger, so that where a fit stops does not count


def fitted(folder, design, printed):
    point = operating_point_source_and_measurement(recorded(folder, design, [SCALE, *printed], 11, ROUTE, 0.03))[
        0
    ].with_effects([parse_effect(SCALE)])
    sensitivities = Sensitivities(point)
    return refine_operating_point(point, sensitivities), sensitivities


def larger(k, place, by):
    """The OperatingPoint with one marker's corners seen where they are on a larger one."""
    one = random_blind_platform_cases_with_truth.Printing(
        "markers",
        (0.0,) * (2 * len(k.observed.markers.id)),
        tuple(by * (k.observed.markers.id == int(place.split()[1]))),
    )
    seen = k.observed.observations
    return replace(
        k, seen=replace(k.observed, observations=replace(seen, uv=seen.uv + k.pixels((*k.effects, one)) - k.pixels()))
    )


@pytest.mark.slow
def test_sides_of_single_markers_make_the_side_of_all_less_sure(tmp_path, design):
    """A marker's side moves the scale of all as a fit to corners so moved finds it; they vary as much as the recording
    shows, not as is tolerated.
    """
    prints = random_blind_platform_cases_with_truth.random_printing_errors(design, np.random.default_rng(3), 3e-6, SIDE)
    refined, sensitivities = fitted(tmp_path, design, [prints])
    found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(refined.marginalised, sensitivities)
    sigma = tolerance_sigmas_from_residuals(found.projected(refined.marginalised), found)
    singles = {s.place: s.columns.start for s in found.sites if s.effect == "print_scale" and s.place != "markers"}
    together = next(s.columns for s in found.sites if s.place == "markers")
    assert 0.5 * SIDE < sigma[list(singles.values())].max() < 1.5 * SIDE and sigma[together] == SIDES.sigma
    off = parameter_errors_per_tolerance_deviation(refined, sensitivities)
    assert off[0, together] == 0  # which is what the scale is the size of
    heaviest = max(singles, key=lambda place: abs(off[0, singles[place]]))
    far = {sign: larger(refined.point, heaviest, sign * FAR) for sign in (1, -1)}
    by = {s: refine_at_fixed_repeated_corner_error(point, sensitivities).values[0] for s, point in far.items()}
    assert (by[1] - by[-1]) / (2 * FAR) == pytest.approx(off[0, singles[heaviest]] / sigma[singles[heaviest]], rel=0.1)
    wide, narrow = (
        float(np.sqrt(one.covariance[0, 0]))
        for one in (widen_intervals_by_temperature_logs_and_tolerances(refined, sensitivities), refined)
    )
    assert wide > 1.2 * narrow and wide**2 == pytest.approx(narrow**2 + (off[0] ** 2).sum())
    true = np.mean((1 + 2e-3) * (1 + np.array(prints.scales))) - 1
    assert abs(refined.values[0] - true) < Z95 * wide


@pytest.mark.slow
def test_markers_that_are_as_stated_leave_intervals_as_they_are(tmp_path, design):
    refined, sensitivities = fitted(tmp_path, design, [])
    assert (
        widen_intervals_by_temperature_logs_and_tolerances(refined, sensitivities).covariance[0, 0]
        < 1.1 * refined.covariance[0, 0]
    )


@pytest.mark.parametrize(
    ("sigma", "ends", "left_open", "interval"),
    [
        (0.1, (1800 / np.exp(0.1 * Z95), 1800 * np.exp(0.1 * Z95)), None, "1479.6 to 2189.7 s"),
        (1.7, (64.30, 50386.6), None, "64.3 to 50386.6 s"),
        (2.5, (60, 1e5), "both", "not determined"),
        (900.0, (60, 1e5), "both", "not determined"),
    ],
)
def test_a_time_constant_stays_within_what_makes_sense_and_says_where_it_is_open(sigma, ends, left_open, interval):
    effect = parse_effect("warm_up:strut2:amplitude=1e-4,time_constant=1800")
    coordinates = fit_coordinates_of_effects((effect,))
    values = np.array([c.read(effect) for c in coordinates])
    found = Refinement(None, None, coordinates, values, np.diag([1e-6, sigma]) ** 2, None).intervals(0)
    value, low, high = found["time_constant"]
    assert (value, low, high) == pytest.approx((1800, *ends), rel=1e-3)
    p = value_with_interval_cut_at_bounds(value, "s", (low, high), effect.parameters[1].bounds)
    assert p.open == left_open and p.ci95 == [low, high]
    finding = FindingEntry("warm_up", "strut 2", {"time_constant": p})
    assert interval in diagnosis_sentences_and_table_rows.parameter_rows(finding)[0][2] and (
        left_open is None
        or f"time_constant 1800.0 s ({interval})" in diagnosis_sentences_and_table_rows.finding_line(finding)
    )
    assert (
        diagnosis_sentences_and_table_rows.finding_size_text(finding) == ", time constant 1800.0 s (not determined)"
    ) is (left_open == "both")


@pytest.mark.parametrize(
    ("ends", "left_open", "interval"),
    [
        ((4e-5, 2.1e-3), "above", "40 µm or more"),
        ((-3e-3, 6e-5), "below", "60 µm or less"),
        ((-1e-5, 6e-5), None, "-10 to 60 µm"),
    ],
)
def test_an_interval_that_is_cut_off_at_one_end_says_so(ends, left_open, interval):
    p = value_with_interval_cut_at_bounds(5e-5, "m", ends, (-2e-3, 2e-3))
    finding = FindingEntry("warm_up", "strut 2", {"amplitude": p})
    assert p.open == left_open and diagnosis_sentences_and_table_rows.parameter_rows(finding) == [
        ("amplitude", "50 µm", interval)
    ]
    assert (
        diagnosis_sentences_and_table_rows.finding_size_text(finding)
        == f", amplitude 50 µm (95 %: {interval.replace(' µm', '')})"
    )
    assert value_with_interval_cut_at_bounds(1.0, "", (0.5, 2.0), (-3, 3)) == Value(1.0, "", [0.5, 2.0])
