"""Nonlinear parameters of what sits at an arm's joints: found between the values of a grid, with intervals that
cover.
"""

import numpy as np
import pytest

from calib.diagnosis.engine.forward_and_backward_term_selection import select_terms
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import term_parameter_covariance
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import linearised_arm_poses_and_geometry
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from rig.effects.framework.machine_motion_and_play import play_operator
from tests.calib import secret_arms
from tests.rig.arms import UR10

RANGE, WEIGHT, PLAYS = 0.14, 2.8e-3, 8  # rad, 1, operators


def lagging(q):
    """Joint 2 lags by nested loops."""
    out = np.zeros(q.shape)
    out[:, 1] = WEIGHT * np.mean(
        [(play_operator(q, RANGE * (k + 0.5) / PLAYS) - q)[:, 1] for k in range(PLAYS)], axis=0
    )
    return out


def found(seed):
    rng = np.random.default_rng(seed)
    arms, _ = linearised_arm_poses_and_geometry(
        secret_arms.tracked(secret_arms.secret(UR10, rng), UR10, 220, rng, deviation=lagging), secret_arms.design(UR10)
    )
    candidates, _ = joint_candidates_and_untested_effects(arms, RequestedEffects())
    return select_terms(ArmProblem(arms, candidates)).fit


@pytest.mark.slow
def test_a_range_between_two_values_of_its_grid_is_found_with_its_weight_and_nothing_besides():
    fit = found(1)
    assert [(t.candidate.name, t.candidate.place) for t in fit.terms] == [("hysteresis", "joint 2")]
    z = scores(fit)
    assert np.abs(z).max() < 3.0, z
    joint = term_parameter_covariance(fit, 0)
    assert joint.names == ("range",) and joint.covariance[1, 1] ** 0.5 < 0.2 * RANGE
    alone = fit.covariance(0)[0, 0]
    assert joint.covariance[0, 0] > 1.5 * alone, "a weight is less sure where its range is not known"


@pytest.mark.slow
def test_intervals_of_range_and_weight_cover():
    fits = [found(seed) for seed in range(10, 40)]
    named = [fit for fit in fits if any(t.candidate.name == "hysteresis" for t in fit.terms)]
    assert len(named) >= 28, "a backlash is hardly told from loops as wide as most moves"
    z = np.array([scores(fit) for fit in named])
    assert (np.abs(z) < 1.96).mean() >= 0.88
    assert np.abs(z.mean(axis=0)).max() < 0.5


def scores(fit):
    """(2,) of weight and range, in standard errors."""
    number = next(i for i, t in enumerate(fit.terms) if t.candidate.name == "hysteresis")
    joint = term_parameter_covariance(fit, number)
    off = np.array([fit.theta[fit.slices[number]][0] - WEIGHT, fit.terms[number].node["range"] - RANGE])
    return off / np.sqrt(np.diag(joint.covariance))
