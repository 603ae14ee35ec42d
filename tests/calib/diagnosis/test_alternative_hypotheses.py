"""Between hypotheses: what a parameter costs, what a refit tells that a scan does not, names that give way,
temperatures nobody logged.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.diagnosis.engine.candidate_scores_and_their_significance import Score
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import PLATFORM
from calib.diagnosis.engine.forward_and_backward_term_selection import _exchanged
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities, platform_candidate
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Candidate, Linear
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from synthetic import unlisted_effects_and_corner_noise
from tests.bench.investigate import POSES, Case
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded
from tests.closed_loops import simulate_with_truth

PLAN = "sobol:30,moving:15,ladder:3,sobol:30,moving:15"


def score(name, place, node, coefficients, linear, delta_chi2=400.0, curve=None):
    """Score of an effect with one or no linear parameter."""
    candidate = platform_candidate(Candidate(BY_NAME[name], place, [node], [Linear(*column) for column in linear]))
    curve = np.array([delta_chi2]) if curve is None else curve
    return Score(
        candidate,
        node,
        np.array(coefficients),
        delta_chi2,
        1e-9,
        1,
        1.0,
        1.0,
        curve,
        candidate.numbers(node, np.array(coefficients)),
    )


def test_what_rigs_do_not_show_costs_more():
    def cost(coefficient):
        return score("thermal_expansion", "rig", {}, [coefficient], [("coefficient", None, 1e-6)]).complexity(5000)

    usual = cost(1.2e-5)
    assert cost(2.0e-5) == pytest.approx(usual) and cost(8e-5) > usual + 10 and cost(-1.2e-5) > usual + 10
    # as sharp as that, over so many orders of magnitude, with either sign
    offset = score("time_offset", "clock", {}, [-0.01], [("offset", None, 1e-3)]).complexity(5000)
    assert offset == pytest.approx(2 * np.log(20 * np.log(60) * 2 / np.sqrt(2 * np.pi)))
    lag = score("servo_lag", "rig", {"time_constant": 0.01}, [], []).complexity(5000)
    assert offset - lag == pytest.approx(2 * np.log(np.log(60) * 2 / np.log(50)))
    # reciprocals: a soft strut is the large effect
    soft, stiff = (
        score("compliance", "rig", {}, [1 / k], [("stiffness", None, 1e-7)]).complexity(5000) for k in (1e5, 1e7)
    )
    assert soft > stiff + 10


def test_a_grids_parameter_costs_what_the_search_over_it_shows():
    flat, sharp = np.full(16, 100.0), np.zeros(16)
    sharp[5] = 100.0
    costs = [
        score("warm_up", "rig", {"time_constant": 900.0}, [2e-5], [("amplitude", None, 1e-6)], 100.0, curve).complexity(
            5000
        )
        for curve in (flat, sharp)
    ]
    assert costs[1] - costs[0] == pytest.approx(2 * np.log(16))
    # one of five other axes is a choice among five, however many frames there are
    costs = [
        score(
            "axis_coupling",
            "strut 1",
            {"other": 3.0},
            [2e-4],
            [("scale", None, 1e-6)],
            100.0,
            100.0 * (np.arange(5) < few),
        ).complexity(5000)
        for few in (5, 1)
    ]
    assert costs[1] - costs[0] == pytest.approx(2 * np.log(5))


@pytest.mark.slow
def test_a_strong_lag_is_told_from_a_clock_by_fitting_both(tmp_path, design):
    rec = recorded(tmp_path, design, ["servo_lag:rig:time_constant=0.045"], route="moving:40,sobol:30,moving:40")
    (finding,) = diagnosis_report(diagnosis_of(rec, only=["servo_lag", "time_offset"])).findings
    assert (finding.effect, finding.place) == ("servo_lag", "rig")
    assert all(a.delta_bic > 20 for a in finding.cannot_be_told_from)


def test_a_large_bias_of_edges_leaves_noise_alone_to_the_finder(tmp_path, design):
    point = operating_point_source_and_measurement(
        recorded(tmp_path, design, ["edge_bias:cameras:bias=0.25"], route="sobol:40", seed=0)
    )[0]
    refined = refine_operating_point(point, Sensitivities(point))
    np.testing.assert_allclose(refined.point.finder, 0.25, atol=0.02)
    model = refined.model
    assert refined.point.standing < 0.01 and (model.corner_residual**2).sum() == pytest.approx(
        len(model.corner_residual) - 6 * model.frames,
        rel=0.15,  # the noise is that of before the bias was known
    )
    strained = model.closure_residual[6 * model.frames :]
    assert 3 * 40**2 < strained @ strained < 3 * 60**2  # what is known of finders says that this is none


@pytest.mark.slow
def test_a_step_soon_after_the_start_is_found(tmp_path, design):
    rec = recorded(tmp_path, design, ["missed_steps:strut4:jump=6e-5,time=70"], route=PLAN)
    found = diagnosis_of(rec, only=["missed_steps", "warm_up", "creep"])
    assert [(e.name, e.place) for e in found.effects] == [("missed_steps", "strut 4")]


@pytest.mark.slow
def test_what_fits_a_name_only_far_from_what_rigs_show_gets_none(tmp_path, design):
    rec = recorded(tmp_path, design, [unlisted_effects_and_corner_noise.SlippingClutch("strut 5", 1.2e-4)], route=PLAN)
    found = diagnosis_of(rec, only=["warm_up", "missed_steps", "creep", "scale_error", "travel_heating"])
    assert not found.effects and found.left[0].place == Place("strut", "5")


@pytest.mark.slow
@pytest.mark.parametrize("scale", [5e-4, -1e-3])
def test_all_struts_scales_off_by_one_share_are_one_name_or_alike_to_it(tmp_path, design, scale):
    """Where they were no hypothesis of their own, they were called a compliance, or a creep with nothing alike to
    it.
    """
    rec = recorded(
        tmp_path,
        design,
        [f"scale_error:strut{k}:scale={scale}" for k in range(1, 7)],
        seed=3,
        route="moving:24,sobol:50",
    )
    (finding,) = diagnosis_of(rec).selection.findings
    named = {(s.candidate.name, s.candidate.place) for s in (finding.score, *(a.score for a in finding.alternatives))}
    assert ("scale_error", "rig") in named
    assert scale < 0 or len(named) == 1


@pytest.mark.slow
def test_an_effect_of_a_temperature_that_nobody_logged_is_among_its_alternatives(tmp_path, design):
    rec = recorded(
        tmp_path, design, ["base_expansion:rig:coefficient=1e-4"], logged=False, route="sobol:50,ladder:2,sobol:60"
    )
    found = diagnosis_of(rec, only=["warm_up", "base_expansion"])
    named = {
        (f.score.candidate.name, *(a.score.candidate.name for a in f.alternatives)) for f in found.selection.findings
    }
    assert found.effects and all("base_expansion" in names for names in named)


@pytest.mark.parametrize(
    ("text", "alike"),
    [
        ("thermal_expansion:strut4:coefficient=6e-5", "warm_up"),
        pytest.param("focal_drift:camera cam1:per_kelvin=1.5e-4", "camera_drift", marks=pytest.mark.slow),
    ],
)
def test_such_an_effect_is_a_rival_at_its_own_place(tmp_path, design, text, alike):
    name, place, _ = text.split(":")
    rec = recorded(tmp_path, design, [text], logged=False, route="sobol:50,ladder:2,sobol:60")
    found = diagnosis_of(rec, only=[alike, name])
    sets = [
        [(a.score.candidate.name, a.score.candidate.place) for a in f.alternatives] for f in found.selection.findings
    ]
    assert found.effects[0].name == alike and (name, place.replace("strut", "strut ")) in sets[0]


@pytest.mark.slow
def test_an_effect_of_a_temperature_that_drowns_in_its_log_is_among_its_alternatives(tmp_path, design):
    rec = recorded(
        tmp_path,
        design,
        ["thermal_expansion:strut4:coefficient=2.4e-5"],
        route="sobol:50,ladder:2,sobol:60",
        noise=0.015,
    )
    t, name = np.linspace(0, rec.sensors.t[-1], 9), "strut4_temperature_C"
    channels = {channel: rec.sensors.at(t, channel) for channel in rec.sensors.channels}
    noisy = channels[name] + np.ptp(channels[name]) * np.array([1, -1, 0.5, -0.5, 0.2, -1, 0.8, -0.5, 0.5])
    channels[name] = noisy - np.polyval(np.polyfit(t, noisy, 1), t) + 20.5  # not even the slope shows
    (finding,) = diagnosis_of(
        replace(rec, sensors=replace(rec.sensors, t=t, channels=channels)), only=["thermal_expansion", "warm_up"]
    ).selection.findings
    named = [(c.name, c.place) for c in (finding.score.candidate, *(a.score.candidate for a in finding.alternatives))]
    assert named[0] == ("warm_up", "strut 4") and ("thermal_expansion", "strut 4") in named


SLOWLY = "sobol:20,wait:15,sobol:20"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "text"),
    [
        (
            101,
            "warm_up:strut 2:amplitude=2.26e-5,time_constant=785.7",
        ),  # which convinces by its fit alone: so may what is held against it
        (
            103,
            "warm_up:strut 1:amplitude=2.723e-05,time_constant=1316",
        ),  # of which a smooth course explains more than a growth, and not than this
    ],
)
def test_a_warm_up_of_micrometres_is_never_a_thermal_expansion_beyond_doubt(tmp_path, seed, text):
    (tmp_path / "rig.toml").write_text(rig_text := hexapod_layout_rig_toml(0.3) + POSES)
    case = Case(tmp_path / "rig", design_from_rig_toml.load_design(tmp_path / "rig.toml"), rig_text, text, seed)
    (finding,) = case.first(SLOWLY)[1].selection.findings
    named = [finding.score.candidate, *(a.score.candidate for a in finding.alternatives)]
    assert ("warm_up", text.split(":")[1]) in [(c.name, c.place) for c in named]


@pytest.mark.parametrize(
    "scanned, fitted, tried", [(900.0, 1500.0, False), (400.0, 1500.0, True), (400.0, 700.0, True)]
)
def test_a_variant_that_a_scan_does_not_tell_from_the_best_is_held_against_it_fitted(scanned, fitted, tried):
    best, other = (
        score("thermal_expansion", "rig", {}, [1e-5], [("coefficient", None, 1e-6)], delta)
        for delta in (scanned, scanned - 30)
    )
    fitted_variants = []

    def add_term(fit, new):
        fitted_variants.append(new)
        return fit - fitted

    problem = SimpleNamespace(
        policy=PLATFORM, size=lambda fit: 5000, add_term=add_term, likelihood_ratio=lambda fit, new: fit - new
    )
    elsewhere = score("thermal_expansion", "strut 1", {}, [1e-5], [("coefficient", None, 1e-6)], scanned)
    found, chosen = _exchanged(problem, 0.0, -900.0, best, [best, elsewhere, other])  # fitted, the best explains 900
    assert fitted_variants == ([other] if tried else [])
    assert (found, chosen) == ((-fitted, other) if tried and fitted > 900 else (-900.0, best))


@pytest.mark.slow
@pytest.mark.parametrize("camera, terms", [("cam1", (2e-2, 0, 2e-2, 0)), ("cam2", (-3e-2, 1e-2, 0, 0))])
def test_a_large_bend_of_a_lens_is_one_finding_of_the_terms_that_it_has(tmp_path, camera, terms):
    (tmp_path / "rig.toml").write_text(hexapod_layout_rig_toml(0.3))
    text = "/".join(map(str, (*[0] * 8, *terms)))
    simulate_with_truth(
        tmp_path, "standard", 5, "--effect", f"lens_distortion:{camera}:terms={text}", "--noise", "0.03"
    )
    found = diagnosis_of(recording_folder.load_recording(tmp_path / "rec"), only=["lens_distortion"]).effects
    assert [(e.name, e.place) for e in found] == [("lens_distortion", f"camera {camera}")]
    assert not found[0].warp and np.flatnonzero(found[0].terms).min() == 8
