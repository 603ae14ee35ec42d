"""Covariates are ranked by what they explain of the remainder: the one that an effect follows leads before, and nothing
is left to it after.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import NO_STATED_TERMS
from calib.diagnosis.engine.forward_and_backward_term_selection import select_terms
from calib.diagnosis.problems.arm.arm_lack_of_fit_covariates_and_joint_formulas import ranked_covariates
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import linearised_arm_poses_and_geometry
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import fit_terms_to_poses
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from calib.diagnosis.report.diagnosis_sentences_and_table_rows import covariate_table_heads_and_rows
from rig.effects.framework.machine_motion_and_play import Path, play_operator
from rig.recording.recording_folder import Sensors
from tests.calib import secret_arms
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded
from tests.rig.arms import UR10


@pytest.fixture(scope="module")
def rec(tmp_path_factory, design):
    found = recorded(tmp_path_factory.mktemp("rec"), design, ["settling_error:strut3:fraction=2e-3"], route="sobol:60")
    rng = np.random.default_rng(3)
    odd = {
        "humidity_percent": 40 + rng.normal(size=len(found.sensors.t)).cumsum() * 0.1,
        "doors": np.zeros(len(found.sensors.t)),
    }
    return replace(found, sensors=Sensors(found.sensors.t, {**found.sensors.channels, **odd}))


@pytest.mark.slow
def test_what_an_effect_follows_leads_and_is_gone_after(rec):
    report = diagnosis_report(diagnosis_of(rec, ["settling_error"]))
    names = [c.name for c in report.covariates]
    assert (
        names[0] == "step"
        and {"time", "order", "direction", "dwell", "way travelled", "humidity_percent"} <= set(names)
        and "doors" not in names
    )
    by = {c.name: c.explains for c in report.covariates}
    assert by["step"]["struts"].before > 0.1 > 0.05 > by["step"]["struts"].after
    assert by["humidity_percent"]["struts"].p_value > 1e-3 and by["humidity_percent"]["images"].after < 0.01
    heads, rows = covariate_table_heads_and_rows(report.covariates)
    assert heads[0] == "goes with" and len(heads) == len(rows[0]) == 6 and rows[0][0] == "step"


def test_a_dwell_counts_from_the_last_move():
    t, lengths = np.array([0.0, 1.0, 2.0, 5.0, 6.0]), np.array([[1.0], [1.0], [2.0], [2.0], [3.0]])
    assert Path(t, lengths, np.array([1, 2, 3, 4])).dwell.tolist() == [1.0, 0.0, 3.0, 0.0]


def test_of_an_arm_too(arm_with_play):
    problem, arms = arm_with_play
    covariates = {
        c.name: c
        for c in ranked_covariates(fit_terms_to_poses(arms), select_terms(problem).fit, problem.policy.cluster)
    }
    assert next(iter(covariates)) == "direction" and {"time", "order", "step", "way travelled"} <= set(covariates)
    assert covariates["direction"].before["joints"].share > 0.1 > 0.01 > covariates["direction"].after["joints"].share


@pytest.fixture(scope="module")
def arm_with_play():
    """(ArmProblem, Arms) of a UR10 with backlash in joint 3 alone."""
    rng = np.random.default_rng(5)
    true = secret_arms.secret(UR10, rng)

    def deviation(q):
        return (play_operator(q, 3e-4) - q) * (np.arange(6) == 2)

    arms, _ = linearised_arm_poses_and_geometry(
        secret_arms.tracked(true, UR10, 150, rng, deviation=deviation), secret_arms.design(UR10)
    )
    candidates, _ = joint_candidates_and_untested_effects(arms, RequestedEffects.of(["backlash"], (), NO_STATED_TERMS))
    return ArmProblem(arms, candidates), arms
