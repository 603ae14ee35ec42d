"""Screened for all terms at once, no candidate is missed that an exact scan in a term's place finds to explain as
much.
"""

import numpy as np
import pytest

from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import find_alternatives
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from rig.recording.recording_folder import load_recording
from tests.bench.several_faults import drawn
from tests.truth import record

SITES = {
    71003: [("creep", "strut 1"), ("missed_steps", "strut 5"), ("missed_steps", "strut 6"), ("hysteresis", "strut 2")],
    71010: [("base_expansion", "rig"), ("creep", "strut 4"), ("creep", "strut 1"), ("creep", "rig")],
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", SITES)
def test_all_that_an_exact_scan_finds_passes(tmp_path, seed):
    sites = SITES[seed]
    point = operating_point_source_and_measurement(load_recording(record(drawn(seed, 2)[0], tmp_path / "rec")))[0]
    problem = PlatformProblem(point, platform_candidates_and_untested_effects(point, RequestedEffects())[0])
    fit = problem.start()
    for name, place in sites:
        own = [c for c in problem.candidates if (c.name, c.place) == (name, place)]
        fit = problem.add_term(fit, problem.search(problem.residual(fit), own)[0])
    screened = problem.screen_alternatives(fit)
    assert screened is not None and len(screened) == len(sites)
    for number, passed in enumerate(screened):
        model, score = (
            problem.without_term(fit, number),
            problem.rescored(problem.without_term(fit, number), fit, number),
        )
        exact = find_alternatives(problem, model, score, None)
        assert [a.score.candidate.place for a in exact if not any(a.score.candidate is c for c in passed)] == []
        assert any(fit.terms[number] is c for c in passed)
        np.testing.assert_allclose(
            [a.behind for a in find_alternatives(problem, model, score, None, None, lambda p=passed: p)],
            [a.behind for a in exact],
        )
    assert sum(map(len, screened)) < len(sites) * len(problem.candidates) / 2  # else nothing is spared


def test_hypotheses_that_say_the_same_explain_the_same_whichever_sizes_a_scan_tries(tmp_path):
    """A clock is late and a strut has backlash. By the tried sizes alone the lateness explained 5 % less than a lag of
    all drives that is the same motion, and the lag's set lost the clock.
    """
    point = operating_point_source_and_measurement(load_recording(record(drawn(91007, 2)[0], tmp_path / "rec")))[0]
    problem = PlatformProblem(point, platform_candidates_and_untested_effects(point, RequestedEffects())[0])
    sites = [("backlash", "strut 5"), ("time_offset", "clock"), ("servo_lag", "rig")]
    backlash, *both = [[c for c in problem.candidates if (c.name, c.place) == site] for site in sites]
    fit = problem.start()
    fit = problem.add_term(fit, problem.search(problem.residual(fit), backlash)[0])
    late, lag = (problem.search(problem.residual(fit), own)[0].delta_chi2 for own in both)
    assert lag > 500 and late == pytest.approx(lag, rel=0.005)
