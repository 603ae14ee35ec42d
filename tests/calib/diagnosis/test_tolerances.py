"""A finding has to matter: what printers, finders and thermometers may do on their own is a remark with its size, and
hides nothing.
"""

import json

import numpy as np
import pytest

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import NO_STATED_TERMS
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import normal_equations_by_common_weights
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.problems.platform import marker_and_thermometer_tolerance_model_and_significance
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    Sensitivities,
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, linearise
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import (
    candidate_column,
    constant_displacement_normal_equations,
    corner_displacement_normal_equations_by_frame,
    score_candidates,
)
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.effects.catalogue import effect_list
from rig.model.arm_hands_effect_places_and_tolerances import PLACES, SIDES, Place
from synthetic import random_blind_platform_cases_with_truth
from tests.calib.diagnose_recording import diagnosis_of, page_text
from tests.calib.recordings_with_effects import recorded

ROUTE, PRINTED = (
    "sobol:30,ladder:1",
    ["print_scale", "face_misplacement", "cube_misplacement", "edge_bias", "lens_distortion", "backlash"],
)


def printed(design, place, side, seed=1):
    return random_blind_platform_cases_with_truth.random_printing_errors(
        design, np.random.default_rng(seed), place, side
    )


@pytest.mark.parametrize(
    ("place", "side"),
    [pytest.param(1e-5, 0.0, marks=pytest.mark.slow), pytest.param(0.0, 2.5e-4, marks=pytest.mark.slow), (5e-6, 2e-4)],
)
def test_markers_printed_within_tolerance_are_no_finding(tmp_path, design, place, side):
    found = diagnosis_of(recorded(tmp_path, design, [printed(design, place, side)], 11, ROUTE, 0.03), only=PRINTED)
    tree = json.loads(json.dumps(diagnosis_report(found).tree()))
    assert tree["findings"] == [] and tree["unexplained"] is None


@pytest.mark.slow
def test_all_sides_off_by_a_part_in_two_thousand_are_a_remark_with_their_size(tmp_path, design):
    rec = recorded(tmp_path, design, [f"print_scale:markers:scale={SIDES.limit}"], 11, ROUTE, 0.03)
    found = diagnosis_of(rec, only=PRINTED)
    tree = json.loads(json.dumps(diagnosis_report(found).tree()))
    assert tree["findings"] == [] and tree["unexplained"] is None
    remark = {(r["effect"], r["place"]): r for r in tree["remarks"]}["print_scale", "markers"]
    low, high = remark["parameters"]["scale"]["ci95"]
    assert low < SIDES.limit < high and high - low < SIDES.limit and "0.05 %" in remark["reason"]
    page_text(tmp_path / "page.html", rec, found)
    assert "print scale at markers" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_what_is_beyond_tolerance_is_a_finding_beside_what_is_within(tmp_path, design):
    hidden = ["face_misplacement:8:offset=2e-4/0/0,rotation=0/0/0", "backlash:strut2:gap=6e-5"]
    found = diagnosis_of(
        recorded(tmp_path, design, [*hidden, printed(design, 5e-6, 1e-4)], 11, ROUTE, 0.03), only=PRINTED
    )
    assert {(e.name, e.place) for e in found.effects} == {
        ("face_misplacement", "marker 8"),
        ("backlash", "strut 2"),
    } and not found.left


def test_tolerances_are_not_at_work_where_nothing_is_off(tmp_path, design):
    point = operating_point_source_and_measurement(recorded(tmp_path, design, [], 11, ROUTE, 0.03))[0]
    model, sensitivities = linearise(point), Sensitivities(point)
    found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(model, sensitivities)
    assert (
        not marker_and_thermometer_tolerance_model_and_significance.tolerances_explain_residuals(
            found.projected(model), found.sigma
        )
        and marker_and_thermometer_tolerance_model_and_significance.significant_tolerances(model, found) == []
    )
    tolerant = marker_and_thermometer_tolerance_model_and_significance.model_with_tolerances(model, found)
    assert tolerant.size <= model.size and tolerant.linear.cost() <= model.linear.cost()
    basis, closures = tolerant.linear.columns.parts, tolerant.closure_residual
    assert np.abs(basis[0].T @ tolerant.corner_residual + basis[CLOSURES].T @ closures).max() < 1e-6


def test_a_prior_holds_what_tolerances_explain(tmp_path, design):
    """The cost that is left beside tolerances is that of the best sizes under their priors."""
    scale = effect_list.BY_NAME["print_scale"]("markers", 4 * SIDES.limit)
    point = operating_point_source_and_measurement(recorded(tmp_path, design, [scale], 11, ROUTE, 0.03))[0]
    model, sensitivities = linearise(point), Sensitivities(point)
    found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(model, sensitivities)
    seen = model.linear.project(found.column(model))
    best = np.linalg.solve(seen.gram + np.diag(found.sigma**-2.0), seen.right)
    assert marker_and_thermometer_tolerance_model_and_significance.tolerances_explain_residuals(
        found.projected(model), found.sigma
    )
    assert marker_and_thermometer_tolerance_model_and_significance.model_with_tolerances(
        model, found
    ).linear.cost() == pytest.approx(model.linear.cost() - seen.right @ best, rel=1e-9)
    assert found.sigma[1] == PLACES.sigma and found.sites[1].effect == "face_misplacement"


@pytest.mark.slow
def test_tolerances_are_projected_as_their_columns_written_out(tmp_path, design):
    point = operating_point_source_and_measurement(
        recorded(tmp_path, design, [printed(design, 5e-6, 1e-4)], 11, ROUTE, 0.03)
    )[0]
    model, sensitivities = linearise(point), Sensitivities(point)
    found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(model, sensitivities)
    written, short = model.linear.project(found.column(model)), found.projected(model)
    assert short.onto == pytest.approx(written.onto, abs=1e-9 * np.abs(written.onto).max())
    assert short.right == pytest.approx(written.right, abs=1e-9 * np.abs(written.right).max())
    assert short.gram == pytest.approx(written.gram, abs=1e-9 * np.abs(written.gram).max())


@pytest.mark.slow
def test_the_share_that_is_left_beside_tolerances_is_that_of_a_search_beside_them(tmp_path, design):
    point = operating_point_source_and_measurement(
        recorded(tmp_path, design, ["backlash:strut2:gap=6e-5"], 11, ROUTE, 0.03)
    )[0]
    model, sensitivities = linearise(point), Sensitivities(point)
    found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(model, sensitivities)
    candidates, _ = platform_candidates_and_untested_effects(
        point, RequestedEffects.of(["backlash", "print_scale"], (), NO_STATED_TERMS)
    )
    with_tolerances = marker_and_thermometer_tolerance_model_and_significance.model_with_tolerances(model, found)
    for candidate in candidates:
        alone, both = (score_candidates(m, [candidate], sensitivities)[0] for m in (model, with_tolerances))
        if alone.node == both.node:  # else two sizes are compared
            column = candidate_column(model, candidate, alone.node, sensitivities)
            share = marker_and_thermometer_tolerance_model_and_significance.share_not_explained_by_tolerances(
                model, found, column, not len(alone.coefficients)
            )
            assert share * alone.delta_chi2 * alone.dispersion == pytest.approx(
                both.delta_chi2 * both.dispersion, rel=1e-6, abs=1e-6
            )


def test_what_lasts_is_scored_by_sums_as_frame_by_frame(tmp_path, design):
    point = operating_point_source_and_measurement(
        recorded(tmp_path, design, ["face_misplacement:8:offset=2e-4/0/0,rotation=0/0/0"], 11, ROUTE, 0.03)
    )[0]
    model, sensitivities = linearise(point), Sensitivities(point)
    candidates, _ = platform_candidates_and_untested_effects(
        point, RequestedEffects.of(["face_misplacement", "edge_bias"], (), NO_STATED_TERMS)
    )
    for candidate in candidates[::7]:
        rows, quads = sensitivities.seen(candidate, candidate.grid[0])
        short = constant_displacement_normal_equations(model, *sensitivities.touched(rows, quads))
        whole = normal_equations_by_common_weights(
            corner_displacement_normal_equations_by_frame(model, sensitivities.corners(rows, quads)),
            np.ones((1, model.frames)),
        )
        for one, other in zip(short, whole):
            assert one == pytest.approx(other, abs=1e-9 * np.abs(whole.raw).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "first"), [("face_misplacement:8:offset=1e-3/0/0,rotation=0/0/0", False), (None, True)]
)
def test_tolerances_come_in_where_they_explain_more_than_the_best_candidate(tmp_path, design, hidden, first):
    """A strong effect may look like tolerances at work, and is admitted before them; printed markers off by what
    printers do come first.
    """
    point = operating_point_source_and_measurement(
        recorded(tmp_path, design, [hidden or printed(design, 1e-5, 2.5e-4)], 11, ROUTE, 0.03)
    )[0]
    candidates, _ = platform_candidates_and_untested_effects(
        point, RequestedEffects.of(["backlash", "face_misplacement"], (), NO_STATED_TERMS)
    )
    problem = PlatformProblem(point, candidates)
    fit = problem.start()
    found = marker_and_thermometer_tolerance_model_and_significance.tolerance_model(
        fit.refined.model, problem.sensitivities
    )
    assert marker_and_thermometer_tolerance_model_and_significance.tolerances_explain_residuals(
        found.projected(fit.refined.model), found.sigma
    )
    best = problem.search(problem.residual(fit), candidates)[0]
    assert problem.tolerances_explain(fit, best) is first and not problem.tolerant  # to ask changes nothing
    assert problem.tolerances_explain(fit, None)  # alone, whatever they explain is theirs
    tolerant = problem.with_tolerances()
    assert tolerant.tolerant and not tolerant.tolerances_explain(fit, None)  # once


@pytest.mark.slow
def test_what_has_no_name_beside_tolerances_is_left_and_offered_a_formula(tmp_path, design):
    hidden = ["backlash:strut2:gap=6e-5", printed(design, 5e-6, 2e-4)]
    found = diagnosis_of(recorded(tmp_path, design, hidden, 11, ROUTE, 0.03), only=["print_scale", "face_misplacement"])
    assert {u.place for u in found.left} == {Place("strut", "2")} and {s.place for s in found.suggestions} == {
        "strut 2"
    }
