"""A law is a family: machines that follow another formula than ours keep the name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import Normal, solve_nonnegative
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.recording.recording_folder import load_recording
from tests.calib.diagnose_recording import diagnosis_of
from tests.truth import case as cases
from tests.truth import draw, memories, places, record

CONFIGURATIONS = 150
LOGARITHMIC = ("creep", 1)  # creep with the logarithm of time
REACH = 1.5e-3 * (np.arange(8) + 0.5) / 8  # m, of sliders of which the short ones carry most
WEIGHTS = 0.095 / np.arange(1, 9) / (1 / np.arange(1, 9)).sum()
AXIS = np.eye(6)[2]
NOISE = (2e-6, 2e-5)  # m, rad of the instrument
ALL_AXES = np.array([0.9, 1.1, 1.0, 0.7, 0.8, 0.7])


def hexapod(effect, seed, variant=None):
    """A case of the independent truth, its fault by one of the laws of an effect."""
    return draw(seed, effect, "strong", "shuffled", "hexapod", count=CONFIGURATIONS, variant=variant)


def diagnosed(folder, case, seed=1, **changes):
    """Diagnosis of a case with changes, seen anew with noise of a seed."""
    case = replace(case, **changes)
    case = replace(case, seen=cases._seen(case, np.random.default_rng(seed)))
    return diagnosis_of(load_recording(record(case, folder / "rec")))


def at_strut_3(case):
    return (replace(case.laws[0], axes=AXIS),)


def sites(found):
    return sorted((effect.name, effect.place) for effect in found.effects)


@pytest.mark.parametrize("seed", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_struts_that_give_alike_are_one_finding_of_the_rig_and_not_six(tmp_path, seed):
    case = hexapod("compliance", seed, 0)
    found = diagnosed(tmp_path, case, seed, laws=(replace(case.laws[0], axes=np.full(6, 0.15)),))
    assert sites(found) == [("compliance", "rig")] and not found.left


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["scale_error", "axis_coupling"])
def test_a_scale_that_grows_along_the_travel_keeps_its_name(tmp_path, effect):
    case = hexapod(effect, 4, 1)
    assert case.laws[0].bow
    law = replace(case.laws[0], axes=AXIS, bow=1.5 * case.laws[0].bow)
    (finding,) = diagnosis_report(diagnosed(tmp_path, case, laws=(law,))).findings
    assert (finding.effect, finding.place) == (effect, "strut 3")
    half = float(np.ptp(case.owner.ranges, axis=1).mean() / 2)
    low, high = finding.parameters["curvature"].ci95
    assert low - 0.05 <= law.bow * half / law.share <= high + 0.05  # half of the real travel, and not of the stated


@pytest.mark.slow
@pytest.mark.parametrize("waves", [0, 1])
def test_a_profile_is_no_scale_that_grows(tmp_path, waves):
    case = hexapod("transmission_error", 6, waves)
    found = diagnosed(tmp_path, case, laws=at_strut_3(case))
    assert "transmission_error" in dict(sites(found)) and "scale_error" not in dict(sites(found))


@pytest.mark.slow
def test_steps_that_all_struts_miss_at_once_are_missed_steps_of_the_rig(tmp_path):
    case = hexapod("missed_steps", 3, 0)
    found = diagnosed(tmp_path, case, laws=(replace(case.laws[0], axes=np.ones(6)),))
    assert sites(found) == [("missed_steps", "rig")] and not found.left


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect, sites",
    [
        ("time_offset", {("time_offset", "clock"), ("servo_lag", "rig")}),  # a clock and a lag of all are alike there
        ("servo_lag", {("servo_lag", "strut 2")}),
    ],
)
def test_a_late_clock_shows_at_exposures_just_after_arrival_and_is_no_creep(tmp_path, effect, sites):
    report = diagnosis_report(diagnosed(tmp_path, hexapod(effect, 3, 0), 3))
    (finding,) = report.findings
    named = {(finding.effect, finding.place)} | {(a.effect, a.place) for a in finding.cannot_be_told_from}
    assert sites <= named and (finding.effect, finding.place) in sites and not report.unknown


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_loops_of_another_shape_are_hysteresis(tmp_path, seed):
    sliders = memories.Sliders(AXIS, REACH, WEIGHTS, np.zeros(6))
    found = diagnosed(tmp_path, hexapod("hysteresis", seed), seed, laws=(sliders,), sigma=NOISE)
    assert sites(found) == [("hysteresis", "strut 3")] and not found.left


@pytest.mark.slow
@pytest.mark.parametrize("axes", [AXIS, ALL_AXES], ids=["one strut", "all struts"])
@pytest.mark.parametrize("share", [0.55, 0.9, 1.0])
def test_bristles_that_bend_and_slip_are_hysteresis(tmp_path, share, axes):
    bristles = memories.Bristles(axes, np.array([4e-3]), np.array([1.5e-2]), share, np.zeros(6))
    found = diagnosed(tmp_path, hexapod("hysteresis", 1), laws=(bristles,), sigma=NOISE)
    assert {("hysteresis", f"strut {i + 1}") for i in np.flatnonzero(axes)} <= set(sites(found))


@pytest.mark.slow
@pytest.mark.parametrize("effect, variant", [("creep", 0), ("creep", 1), ("warm_up", 0), ("thermal_expansion", 1)])
def test_several_times_and_late_heat_keep_the_name(tmp_path, effect, variant):
    case = hexapod(effect, 2, variant)
    found = diagnosed(tmp_path, case, 2, laws=at_strut_3(case))
    assert sites(found) == [(effect, "strut 3")]
    if (effect, variant) == LOGARITHMIC:  # three times do not make up a logarithm: the rest is stated at its place
        assert {u.place for u in found.left} == {Place("strut", "3")}
    else:
        assert not found.left


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_profile_with_kinks_is_a_transmission_error(tmp_path, seed):
    case = hexapod("transmission_error", 1, 1)
    found = diagnosed(tmp_path, case, seed, laws=at_strut_3(case))
    assert sites(found) == [("transmission_error", "strut 3")]


@pytest.mark.slow
def test_a_screw_coupling_that_grows_with_the_twist_keeps_its_name(tmp_path):
    found = diagnosed(tmp_path, hexapod("screw_coupling", 3), 3, laws=(places.Twisted(AXIS, 0.004, 1.0, 1.0),))
    assert sites(found) == [("screw_coupling", "strut 3")] and not found.left
    assert found.effects[0].growth > 0


def test_nothing_below_zero_and_the_best_of_that():
    rng = np.random.default_rng(3)
    A, y = rng.normal(size=(5, 40, 4)), rng.normal(size=(5, 40))
    G, b = np.swapaxes(A, 1, 2) @ A, np.einsum("knq,kn->kq", A, y)
    solved = solve_nonnegative(Normal(b, G, np.einsum("kqq->kq", G).copy()))
    for rows, right, x, rank, gain in zip(A, y, solved.coefficients, solved.rank, solved.delta_chi2):
        own = lsq_linear(rows, right, (0, np.inf), tol=1e-14)
        assert (x >= 0).all() and rank == np.count_nonzero(x)
        np.testing.assert_allclose(x, own.x, atol=1e-6)
        np.testing.assert_allclose(gain, right @ right - 2 * own.cost, rtol=1e-6)
